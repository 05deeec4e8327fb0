//! Scenes packed for learning.

use super::GBuffer;
use super::files::{Described, Values, count_name, counts_of, put_image, read_image, read_layers};
use crate::{DataError, Image, SamplerKind, TensorFile, image_io::exr_bytes};
use serde::{Deserialize, Serialize};
use tauflow_contract::{Artifact, Context, KindError, Media, ReadFiles, Stored, WriteFiles, parse_json, pretty_json};

const META: &str = "meta.json";

/// A scene packed for learning: one safetensors blob with `states` [K, H, W, 3] (exposed linear radiance, one for each
/// rung), optionally `gbuffer` [H, W, 6] (albedo, normal), and the note `counts`, a JSON list of K sample counts. The
/// note `sampler` is there where samples are not independent.
#[derive(Clone, Debug, PartialEq)]
pub struct PackedScene {
    /// Sample counts, increasing.
    pub counts: Vec<u64>,
    /// The rungs, exposed.
    pub states: Vec<Image>,
    /// Albedo and normal, 6 channels.
    pub gbuffer: Option<Image>,
    /// How the samples of the rungs were drawn.
    pub sampler: SamplerKind,
}

/// The metadata in `meta.json`, apart from that of pixel values.
#[derive(Default, Serialize, Deserialize)]
struct Meta {
    #[serde(default = "SamplerKind::unsaid", skip_serializing_if = "SamplerKind::is_independent")]
    sampler: SamplerKind,
}

impl PackedScene {
    /// A G-buffer that belongs to the rungs: albedo and normal for each of their pixels.
    fn check_gbuffer(&self) -> Result<(), DataError> {
        let (Some(state), Some(gbuffer)) = (self.states.first(), &self.gbuffer) else { return Ok(()) };
        let (width, height) = (state.width(), state.height());
        if (gbuffer.width(), gbuffer.height(), gbuffer.channels()) != (width, height, 6) {
            return Err(DataError::Format(format!(
                "the G-buffer has {} x {} pixels of {} values, the rungs {width} x {height}; it needs as many, of 6",
                gbuffer.width(),
                gbuffer.height(),
                gbuffer.channels()
            )));
        }
        Ok(())
    }

    /// Its blob.
    ///
    /// # Errors
    /// If the rungs have different shapes, or the G-buffer is of another size.
    pub fn to_bytes(&self) -> Result<Vec<u8>, DataError> {
        let first = self.states.first().ok_or_else(|| DataError::Format("a packed scene without rungs".into()))?;
        if self.states.iter().any(|s| !s.same_shape(first)) || self.states.len() != self.counts.len() {
            return Err(DataError::Format(
                "the rungs of a packed scene differ in shape, or in number from its counts".into(),
            ));
        }
        self.check_gbuffer()?;
        let shape = [self.states.len(), first.height(), first.width(), first.channels()];
        let data = self.states.iter().flat_map(|s| s.data().iter().copied()).collect();
        let mut file = TensorFile::default()
            .with("states", &shape, data)
            .note("counts", serde_json::to_string(&self.counts).expect("numbers"));
        if !self.sampler.is_independent() {
            file = file.note("sampler", serde_json::to_string(&self.sampler).expect("a name"));
        }
        if let Some(gbuffer) = &self.gbuffer {
            file = file.with_image("gbuffer", gbuffer);
        }
        file.to_bytes()
    }

    /// Reads its blob.
    ///
    /// # Errors
    /// If it is damaged.
    pub fn from_bytes(bytes: &[u8]) -> Result<Self, DataError> {
        let file = TensorFile::from_bytes(bytes)?;
        let states = file.get("states")?;
        let [rungs, height, width, channels] = states.shape[..] else {
            return Err(DataError::Format(format!("`states` has shape {:?}, expected [K, H, W, 3]", states.shape)));
        };
        let counts: Vec<u64> = file
            .metadata
            .get("counts")
            .and_then(|json| serde_json::from_str(json).ok())
            .ok_or_else(|| DataError::Format("a packed scene without the note `counts`".into()))?;
        if counts.len() != rungs {
            return Err(DataError::Format(format!("{} counts for {rungs} rungs", counts.len())));
        }
        // An empty scene could say any number of pixels.
        if states.data.is_empty() || channels != 3 {
            return Err(DataError::Format(format!("`states` has shape {:?}, expected [K, H, W, 3]", states.shape)));
        }
        let values = states.data.chunks_exact(states.data.len() / rungs);
        let states = values.map(|v| Image::from_data(width, height, channels, v.to_vec())).collect::<Result<_, _>>()?;
        let gbuffer = file.tensors.contains_key("gbuffer").then(|| file.image("gbuffer")).transpose()?;
        let sampler = match file.metadata.get("sampler") {
            None => SamplerKind::unsaid(),
            Some(json) => serde_json::from_str(json)
                .map_err(|e| DataError::Format(format!("the note `sampler` of a packed scene: {e}")))?,
        };
        let packed = Self { counts, states, gbuffer, sampler };
        packed.check_gbuffer()?;
        Ok(packed)
    }
}

impl Media for PackedScene {
    const NAME: &'static str = "tauflow/packed-scene";
    const DOC: &'static str = "Rungs as EXR and PNG, `gbuffer.exr` with layers albedo and normal, and `meta.json`.";

    fn load(ctx: &Context<'_>, artifact: &Artifact) -> Result<Self, KindError> {
        Ok(Self::from_bytes(&ctx.part(artifact, "")?)?)
    }

    fn store(&self, ctx: &Context<'_>) -> Result<Stored<Self>, KindError> {
        Ok(Stored::blob(ctx.put(&self.to_bytes()?)?))
    }

    fn export(ctx: &Context<'_>, artifact: &Artifact, to: &mut dyn WriteFiles) -> Result<(), KindError> {
        let packed = Self::load(ctx, artifact)?;
        let values = Values::of_exposed(to)?;
        let meta = Meta { sampler: packed.sampler };
        to.put(META, &pretty_json(&Described { meta, values: Some(values) })?)?;
        for (count, state) in packed.counts.iter().zip(&packed.states) {
            put_image(to, &count_name(*count), &values.written(state))?;
        }
        if let Some(gbuffer) = &packed.gbuffer {
            let (albedo, normal) = (gbuffer.channels_of(0..3), gbuffer.channels_of(3..6));
            to.put(GBuffer::FILE, &exr_bytes(&[(GBuffer::LAYERS[0], &albedo), (GBuffer::LAYERS[1], &normal)])?)?;
        }
        Ok(())
    }

    fn import(ctx: &Context<'_>, from: &dyn ReadFiles) -> Result<Stored<Self>, KindError> {
        let counts = counts_of(from)?;
        // Each on its own: what is wrong in either must not pass for what is missing.
        let meta = from.get(META)?;
        let Meta { sampler } = meta.as_deref().map(|bytes| parse_json(META, bytes)).transpose()?.unwrap_or_default();
        let values: Option<Values> = meta.as_deref().map(|bytes| parse_json(META, bytes)).transpose()?;
        let state = |count: &u64| {
            let image = read_image(from, &format!("{}.exr", count_name(*count)))?;
            values.map_or_else(|| Ok(image.clone()), |values| values.exposed(image.clone()))
        };
        let states = counts.iter().map(state).collect::<Result<Vec<_>, KindError>>()?;
        let gbuffer = match from.get(GBuffer::FILE)? {
            None => None,
            Some(bytes) => {
                let [albedo, normal] = read_layers(GBuffer::FILE, &bytes, GBuffer::LAYERS)?;
                Some(albedo.beside(&normal)?)
            }
        };
        Self { counts, states, gbuffer, sampler }.store(ctx)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn packed_scenes_round_trip() {
        let image = |v: f32| Image::from_data(2, 2, 3, vec![v; 12]).expect("fits");
        let packed = PackedScene {
            counts: vec![1, 2],
            states: vec![image(1.0), image(0.5)],
            gbuffer: Some(Image::new(2, 2, 6)),
            sampler: SamplerKind::Independent,
        };
        let correlated = PackedScene { sampler: SamplerKind::Sobol, ..packed.clone() };
        let (bytes, others) = (packed.to_bytes().expect("consistent"), correlated.to_bytes().expect("consistent"));
        assert_eq!(PackedScene::from_bytes(&others).expect("own bytes"), correlated);
        assert!(!String::from_utf8_lossy(&bytes).contains("sampler"));
        let bytes = packed.to_bytes().expect("consistent");
        assert_eq!(PackedScene::from_bytes(&bytes).expect("own bytes"), packed);
        let wrong = PackedScene { counts: vec![1], ..packed.clone() };
        assert!(wrong.to_bytes().is_err());
        for shape in [[2, 0, 1 << 40, 3], [0, 2, 2, 3], [2, 1, 1, 1]] {
            let data = vec![0.0; shape.iter().product()];
            let notes = serde_json::to_string(&vec![1; shape[0]]).expect("numbers");
            let file = TensorFile::default().with("states", &shape, data).note("counts", notes);
            let error = PackedScene::from_bytes(&file.to_bytes().expect("the shape fits")).expect_err("no scene");
            assert!(error.to_string().contains("expected [K, H, W, 3]"), "{error}");
        }
        for gbuffer in [Image::new(1, 1, 6), Image::new(2, 2, 3)] {
            let states = packed.states.iter().flat_map(|state| state.data().iter().copied()).collect();
            let file = TensorFile::default()
                .with("states", &[2, 2, 2, 3], states)
                .note("counts", "[1,2]")
                .with_image("gbuffer", &gbuffer);
            let bytes = file.to_bytes().expect("plain tensors");
            let error = PackedScene::from_bytes(&bytes).expect_err("another size").to_string();
            assert!(error.contains("the rungs 2 x 2"), "{error}");
            let wrong = PackedScene { gbuffer: Some(gbuffer), ..packed.clone() };
            assert!(wrong.to_bytes().is_err());
        }
    }
}
