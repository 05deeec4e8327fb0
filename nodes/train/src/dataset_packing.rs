#![doc = include_str!("dataset_packing.md")]

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use tauflow_contract::{
    Action, Context, Each, Facts, Group, Kind, KindError, KindSpec, Known, Media, Mode, Out, Outlook, Outputs,
};
use tauflow_data::{
    Image,
    facts::{self, FILM, HAS_GBUFFER, INDEPENDENT, RUNGS},
    records::{Exposure, GBuffer, Ladder, PackedScene},
};

/// The kind `dataset_packing`.
pub struct DatasetPacking;

/// Params of `dataset_packing`: none.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct DatasetPackingParams {}

const LADDERS: Each<Ladder> = Each::new("ladders", "The ladders to pack.");
const GBUFFERS: Each<GBuffer> = Each::new("gbuffers", "Albedo and shading normal of the same scenes.").or_none();
const EXPOSURE: Each<Exposure> = Each::new("exposure", "The exposure of the same scenes.");

const MAIN: Group = Group::main(1);
const PACKED: Out<PackedScene> = Out::new(MAIN, "packed", "Exposed rungs, and the G-buffer if there is one.");

impl Kind for DatasetPacking {
    type Params = DatasetPackingParams;

    fn spec() -> KindSpec {
        KindSpec {
            name: "dataset_packing",
            summary: "Packs exposed rungs and G-buffers for training and evaluation.",
            manual: include_str!("dataset_packing.md"),
            mode: Mode::Map,
            inputs: vec![LADDERS.port(), GBUFFERS.port(), EXPOSURE.port()],
            outputs: vec![PACKED.port()],
            seeded: false,
        }
    }

    fn foresee(_params: &Self::Params, known: &Known) -> Outlook {
        let (ladders, gbuffers) = (known.each(LADDERS), known.each(GBUFFERS));
        let facts = Facts::default()
            .with_some(RUNGS, ladders.facts.get(RUNGS))
            .with_some(FILM, ladders.facts.get(FILM))
            .with_some(INDEPENDENT, ladders.facts.get(INDEPENDENT))
            .with(HAS_GBUFFER, known.has(GBUFFERS.name()));
        Outlook::default().with(PACKED, facts).but(facts::same_film(GBUFFERS, &gbuffers, &ladders))
    }

    fn run(ctx: &Context<'_>, action: &Action<'_, Self::Params>) -> Result<Outputs, KindError> {
        let ladder = action.read(ctx, LADDERS)?;
        let exposure = action.read(ctx, EXPOSURE)?;
        let gbuffer = action.read_if(ctx, GBUFFERS)?;
        let packed = pack(&ladder, &exposure, gbuffer.as_ref())?;
        Ok(Outputs::default().put(PACKED, packed.store(ctx)?))
    }
}

fn pack(ladder: &Ladder, exposure: &Exposure, gbuffer: Option<&GBuffer>) -> Result<PackedScene, KindError> {
    if !(exposure.factor.is_finite() && exposure.factor > 0.0) {
        return Err(KindError::Input(format!(
            "the exposure factor is {}, expected a positive number; check why the gate accepted the scene",
            exposure.factor
        )));
    }
    let exposed = |image: &Image| image.map(|v| (f64::from(v) * exposure.factor) as f32);
    let gbuffer = gbuffer.map(|g| g.albedo.beside(&g.normal)).transpose()?;
    if let Some(gbuffer) = &gbuffer {
        gbuffer.finite("G-buffer", "look at what made it")?;
    }
    if let (Some(gbuffer), Some(rung)) = (&gbuffer, ladder.rungs.first())
        && (gbuffer.width(), gbuffer.height()) != (rung.image.width(), rung.image.height())
    {
        return Err(KindError::Input(format!(
            "the G-buffer has {} x {} pixels, but the ladder has {} x {}; render both with the same `resolution`",
            gbuffer.width(),
            gbuffer.height(),
            rung.image.width(),
            rung.image.height()
        )));
    }
    Ok(PackedScene {
        counts: ladder.rungs.iter().map(|r| r.spp).collect(),
        states: ladder.rungs.iter().map(|r| exposed(&r.image)).collect(),
        gbuffer,
        sampler: ladder.meta.sampler,
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use tauflow_data::{
        IntegratorKind, SamplerKind,
        records::{LadderMeta, Rung},
    };

    fn ladder() -> Ladder {
        let image = |v: f32| Image::from_data(2, 1, 3, vec![v; 6]).expect("fits");
        Ladder {
            meta: LadderMeta {
                counts: vec![1, 2],
                width: 2,
                height: 1,
                rejected: 0,
                mean_path_length: 1.0,
                sampler: SamplerKind::Independent,
                integrator: IntegratorKind::Path,
                estimated_error: None,
            },
            rungs: vec![Rung { spp: 1, image: image(4.0) }, Rung { spp: 2, image: image(3.0) }],
            variance: image(1.0),
        }
    }

    #[test]
    fn packed_scenes_say_how_their_samples_were_drawn() {
        let exposure = Exposure { factor: 1.0, ev: 0.0, mean_luminance: 0.18 };
        for sampler in [SamplerKind::Independent, SamplerKind::Sobol] {
            let mut ladder = ladder();
            ladder.meta.sampler = sampler;
            assert_eq!(pack(&ladder, &exposure, None).expect("a ladder").sampler, sampler);
        }
    }

    #[test]
    fn one_factor_for_all_rungs() {
        let exposure = Exposure { factor: 0.5, ev: 0.0, mean_luminance: 0.36 };
        let gbuffer = GBuffer {
            albedo: Image::from_data(2, 1, 3, vec![0.1, 0.2, 0.3, 0.4, 0.5, 0.6]).expect("fits"),
            normal: Image::from_data(2, 1, 3, vec![0.0, 0.0, 1.0, 1.0, 0.0, 0.0]).expect("fits"),
        };
        let packed = pack(&ladder(), &exposure, Some(&gbuffer)).expect("consistent");
        assert_eq!(packed.counts, [1, 2]);
        assert_eq!((packed.states[0].data()[0], packed.states[1].data()[5]), (2.0, 1.5));
        let features = packed.gbuffer.expect("connected");
        assert_eq!(features.pixel(1, 0), [0.4, 0.5, 0.6, 1.0, 0.0, 0.0]);
    }

    #[test]
    fn what_does_not_fit_is_refused() {
        let good = Exposure { factor: 1.0, ev: 0.0, mean_luminance: 0.18 };
        let bad = Exposure { factor: f64::NAN, ..good.clone() };
        assert!(pack(&ladder(), &bad, None).is_err());
        let small = GBuffer { albedo: Image::new(1, 1, 3), normal: Image::new(1, 1, 3) };
        let error = pack(&ladder(), &good, Some(&small)).expect_err("another size").to_string();
        assert!(error.contains("1 x 1") && error.contains("2 x 1"), "{error}");
    }
}
