//! Pictures of what the gate rejected, by reason, and of what it let through beside them: so that a person can say
//! whether it was right.

use crate::{
    font,
    montage::{centred, paste},
    text::{count, plural},
};
use std::collections::BTreeMap;
use tauflow_contract::{Context, Handle, Items, KindError};
use tauflow_data::{
    Image,
    image::preview,
    image_io::encode_png,
    records::{Ladder, REASONS, Verdict},
};

/// Pictures in a row of a sheet.
const COLUMNS: usize = 10;

/// Scenes of one reason.
#[derive(Clone, Debug)]
pub struct Sheet {
    /// Their first reason; none of those that were let through.
    pub reason: Option<String>,
    /// How many there are.
    pub of: u64,
    /// Some of them, spread evenly over all by key.
    pub pictures: Vec<Shot>,
}

/// A preview.
#[derive(Clone, Debug)]
pub struct Shot {
    /// The scene.
    pub scene: String,
    /// Its further reasons.
    pub also: Vec<String>,
    /// Display-encoded, 3 channels, at the exposure that the gate worked out.
    pub image: Image,
}

/// `wanted` of `count` places, spread evenly.
fn spread(count: usize, wanted: usize) -> impl Iterator<Item = usize> {
    let wanted = wanted.min(count);
    (0..wanted).map(move |i| i * count / wanted)
}

/// The description of a reason; nothing for an unknown one.
pub fn explained(reason: &str) -> &'static str {
    REASONS.iter().find(|(name, _)| *name == reason).map_or("", |(_, what)| what)
}

fn shot(ctx: &Context<'_>, scene: &str, verdict: &Verdict, ladder: Handle<'_, Ladder>) -> Result<Shot, KindError> {
    let meta = Ladder::meta(ctx, ladder)?;
    let last = *meta.counts.last().ok_or_else(|| KindError::Input(format!("the preview of `{scene}` has no rungs")))?;
    // Where pixels are no numbers the gate has worked out none.
    let factor = verdict.measures.get(Verdict::EXPOSURE).copied().unwrap_or(1.0) as f32;
    let image = Ladder::rung(ctx, ladder, last)?.map(|v| preview(v * factor));
    Ok(Shot { scene: scene.to_owned(), also: verdict.reasons.iter().skip(1).cloned().collect(), image })
}

/// One sheet for each reason that was told, the most telling first, and one of scenes that were let through, each of
/// `wanted` scenes at most.
///
/// # Errors
/// If a scene that was judged has no preview, or one is damaged.
pub fn sheets(
    ctx: &Context<'_>,
    previews: Items<'_, Ladder>,
    verdicts: &[(String, Verdict)],
    wanted: usize,
) -> Result<Vec<Sheet>, KindError> {
    // By the place of the reason among all, and its name.
    type By<'v> = BTreeMap<(usize, Option<&'v str>), Vec<&'v (String, Verdict)>>;
    let mut by: By<'_> = BTreeMap::new();
    for judged in verdicts {
        let reason = judged.1.reasons.first().map(String::as_str);
        let place = match reason {
            Some(reason) => REASONS.iter().position(|(name, _)| *name == reason).unwrap_or(REASONS.len()),
            None => REASONS.len() + 1,
        };
        by.entry((place, reason)).or_default().push(judged);
    }
    let mut out = Vec::with_capacity(by.len());
    for ((_, reason), scenes) in by {
        let mut pictures = Vec::new();
        for (scene, verdict) in spread(scenes.len(), wanted).map(|at| scenes[at]) {
            ctx.check_cancelled()?;
            let ladder = previews.get(scene).ok_or_else(|| {
                KindError::Input(format!(
                    "`previews` has no item `{scene}`, which `verdicts` has; connect the previews that the gate judged"
                ))
            })?;
            pictures.push(shot(ctx, scene, verdict, ladder)?);
        }
        out.push(Sheet { reason: reason.map(str::to_owned), of: scenes.len() as u64, pictures });
    }
    Ok(out)
}

impl Sheet {
    /// Name of its file.
    pub fn file(&self) -> String {
        format!("gate-{}.png", self.reason.as_deref().unwrap_or("accepted"))
    }

    /// Its title.
    pub fn title(&self) -> String {
        let shown = match self.pictures.len() as u64 {
            all if all == self.of => String::new(),
            some => format!(", {} shown", count(some)),
        };
        match &self.reason {
            Some(reason) => {
                format!("{}: {}; {}{shown}", reason.replace('_', " "), explained(reason), plural(self.of, "scene"))
            }
            None => format!("accepted: {}{shown}", plural(self.of, "scene")),
        }
    }

    /// All its pictures with their scenes as one labelled PNG on white.
    ///
    /// # Errors
    /// If it cannot be encoded.
    pub fn png(&self) -> Result<Vec<u8>, KindError> {
        const GAP: usize = 6;
        const SCALE: usize = 2;
        const LINE: usize = font::HEIGHT * SCALE + 6;
        let side = |of: fn(&Image) -> usize| self.pictures.iter().map(|shot| of(&shot.image)).max().unwrap_or(1);
        let (width, height) = (side(Image::width), side(Image::height));
        // Small films are enlarged, so that names fit below.
        let zoom = (128 / width.max(height)).max(1);
        let [cell_w, cell_h] = [width * zoom + GAP, height * zoom + LINE + GAP];
        // The letters of sheets are those of ASCII.
        let title = self.title().replace('\u{202f}', " ");
        let columns = self.pictures.len().clamp(1, COLUMNS);
        let rows = self.pictures.len().div_ceil(columns);
        let size = [(columns * cell_w).max(font::width(&title, SCALE)) + 2 * GAP, LINE + 2 * GAP + rows * cell_h];
        let mut sheet = Image::new(size[0], size[1], 3).map(|_| 1.0);
        font::draw(&mut sheet, [GAP, GAP], &title, SCALE, 0.1);
        for (number, shot) in self.pictures.iter().enumerate() {
            let at = [GAP + number % columns * cell_w, LINE + 2 * GAP + number / columns * cell_h];
            paste(&mut sheet, &shot.image, at, zoom);
            centred(&mut sheet, at[0], width * zoom, at[1] + height * zoom + 4, &shot.scene);
        }
        Ok(encode_png(&sheet)?)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::sync::atomic::AtomicBool;
    use tauflow_contract::{Collection, ItemKey, Media, MemoryBlobs, Silent};
    use tauflow_data::{
        IntegratorKind, SamplerKind,
        records::{LadderMeta, Rung},
    };

    fn ladder(value: f32) -> Ladder {
        let image = Image::new(4, 2, 3).map(|_| value);
        let (counts, sampler) = (vec![32], SamplerKind::Independent);
        let meta = LadderMeta {
            counts,
            width: 4,
            height: 2,
            rejected: 0,
            mean_path_length: 1.0,
            sampler,
            integrator: IntegratorKind::Path,
            estimated_error: None,
        };
        Ladder { meta, rungs: vec![Rung { spp: 32, image: image.clone() }], variance: image }
    }

    fn judged(number: usize, reasons: &[&str]) -> (String, Verdict) {
        let measures = BTreeMap::from([(Verdict::EXPOSURE.to_owned(), 0.5)]);
        (
            format!("L0-open-{number:06}"),
            Verdict { reasons: reasons.iter().map(|r| (*r).to_owned()).collect(), measures },
        )
    }

    #[test]
    fn scenes_lie_under_their_first_reason_at_the_gates_exposure() {
        let (blobs, stop) = (MemoryBlobs::default(), AtomicBool::new(false));
        let ctx = Context::new(&blobs, &Silent, &stop);
        let mut verdicts: Vec<(String, Verdict)> = (0..9).map(|i| judged(i, &["dark", "noisy"])).collect();
        verdicts.extend([judged(9, &["old_reason"]), judged(10, &["inside"]), judged(11, &[])]);
        let previews: Collection = (0..12)
            .map(|i| {
                let stored = ladder(2.0 * i as f32).store(&ctx).expect("in memory").into_artifact();
                (ItemKey::new(format!("L0-open-{i:06}")).expect("plain"), stored)
            })
            .collect();
        let sheets = sheets(&ctx, Items::new(&previews).expect("ladders"), &verdicts, 3).expect("all there");
        let found: Vec<(Option<&str>, u64, usize)> =
            sheets.iter().map(|s| (s.reason.as_deref(), s.of, s.pictures.len())).collect();
        assert_eq!(found, [(Some("inside"), 1, 1), (Some("dark"), 9, 3), (Some("old_reason"), 1, 1), (None, 1, 1)]);
        let dark = &sheets[1];
        assert_eq!(dark.pictures.iter().map(|s| &s.scene[8..]).collect::<Vec<_>>(), ["000000", "000003", "000006"]);
        assert_eq!(dark.pictures[1].also, ["noisy"]);
        // 6 at half the exposure.
        assert_eq!(dark.pictures[1].image.data()[0], preview(3.0));
        assert_eq!((dark.file().as_str(), sheets[3].file().as_str()), ("gate-dark.png", "gate-accepted.png"));
        assert_eq!(dark.title(), "dark: most of the frame is displayed black; 9 scenes, 3 shown");
        assert_eq!(sheets[3].title(), "accepted: 1 scene");
        assert!(sheets.iter().all(|sheet| sheet.png().is_ok_and(|png| png.starts_with(b"\x89PNG"))));

        verdicts.push(judged(12, &["dark"]));
        let refused = super::sheets(&ctx, Items::new(&previews).expect("ladders"), &verdicts, 99);
        let refused = refused.expect_err("no preview").to_string();
        assert!(refused.contains("`L0-open-000012`"), "{refused}");
    }
}
