#![doc = include_str!("contact_sheet.md")]

use crate::{
    font,
    montage::{choose, paste},
};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use tauflow_contract::{
    Action, All, Context, FileTree, Files, Group, Kind, KindError, KindSpec, Media, Mode, Out, Outputs,
};
use tauflow_data::{
    ContextClass, Image, Regime, Stratum, StratumName,
    image::preview,
    image_io::encode_png,
    records::{Exposure, Ladder},
};

const LADDERS: All<Ladder> = All::new("ladders", "Ladders of the scenes; their last rungs are shown.");
const EXPOSURE: All<Exposure> = All::new("exposure", "The exposure of the same scenes.");

const SHEET: Out<Files> = Out::new(Group::main(2), "sheet", "`contact_sheet.png`.").single().published();

/// The kind `contact_sheet`.
pub struct ContactSheet;

/// Params of `contact_sheet`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct ContactSheetParams {
    /// Number of scenes per stratum.
    #[schemars(range(min = 1, max = 16))]
    pub columns: u64,
}

impl Default for ContactSheetParams {
    fn default() -> Self {
        Self { columns: 4 }
    }
}

impl Kind for ContactSheet {
    type Params = ContactSheetParams;

    fn spec() -> KindSpec {
        KindSpec {
            name: "contact_sheet",
            summary: "Shows scenes side by side in one image, by regime and context.",
            manual: include_str!("contact_sheet.md"),
            mode: Mode::Gather,
            inputs: vec![LADDERS.port(), EXPOSURE.port()],
            outputs: vec![SHEET.port()],
            seeded: false,
        }
    }

    fn run(ctx: &Context<'_>, action: &Action<'_, Self::Params>) -> Result<Outputs, KindError> {
        let exposures = action.all(EXPOSURE)?;
        let mut pictures: BTreeMap<StratumName, Vec<Image>> = BTreeMap::new();
        for (key, ladder, stratum) in choose(action.all(LADDERS)?, action.params.columns as usize) {
            ctx.check_cancelled()?;
            let exposure = exposures.get(&key).ok_or_else(|| {
                KindError::Input(format!("`exposure` has no item `{key}`; connect the gate that these scenes passed"))
            })?;
            let factor = exposure.load(ctx)?.factor as f32;
            let meta = Ladder::meta(ctx, ladder)?;
            let last = *meta.counts.last().ok_or_else(|| KindError::Input(format!("`{key}` has no rungs")))?;
            let image = Ladder::rung(ctx, ladder, last)?.map(|v| preview(v * factor));
            if pictures.values().flatten().next().is_some_and(|first| !first.same_shape(&image)) {
                return Err(KindError::Input(format!(
                    "the ladder of `{key}` has another resolution than the first; connect ladders of one"
                )));
            }
            pictures.entry(stratum).or_default().push(image);
        }
        if pictures.is_empty() {
            return Err(KindError::Input("there are no ladders whose keys name a stratum".into()));
        }
        let png = encode_png(&sheet(&pictures, action.params.columns as usize))?;
        let files = Files(FileTree::from([("contact_sheet.png".to_owned(), png)]));
        Outputs::default().put_one(SHEET, "sheet", files.store(ctx)?)
    }
}

/// Between pictures, and between strata.
const GAPS: [usize; 2] = [3, 14];

/// Regimes down, contexts across; below them the other strata, each under its name.
fn sheet(pictures: &BTreeMap<StratumName, Vec<Image>>, columns: usize) -> Image {
    const SCALE: usize = 2;
    let line = font::HEIGHT * SCALE;
    let (width, height) = pictures.values().flatten().fold((1, 1), |(w, h), i| (w.max(i.width()), h.max(i.height())));
    // Rows are as high as their names at least.
    let height = height.max(line);
    let generated: Vec<Stratum> = pictures.keys().filter_map(StratumName::generated).collect();
    let regimes: Vec<Regime> = Regime::ALL.into_iter().filter(|r| generated.iter().any(|s| s.regime == *r)).collect();
    let contexts: Vec<ContextClass> =
        ContextClass::ALL.into_iter().filter(|c| generated.iter().any(|s| s.context == *c)).collect();
    let own: Vec<(&StratumName, &Vec<Image>)> =
        pictures.iter().filter(|(name, _)| name.generated().is_none()).collect();
    let left = font::width("L0", SCALE) + 2 * GAPS[1];
    let group = columns * (width + GAPS[0]) - GAPS[0] + GAPS[1];
    let top = line + 2 * GAPS[1];
    let grid = match regimes.len() {
        0 => [0, 0],
        rows => [left + contexts.len() * group, top + rows * (height + GAPS[0]) - GAPS[0] + GAPS[1]],
    };
    let named = own.iter().map(|(name, _)| font::width(name.as_str(), SCALE) + GAPS[1]).max().unwrap_or(0);
    let below = if own.is_empty() { 0 } else { left + named.max(group) };
    let row = GAPS[1] + line + GAPS[1] + height;
    let last = if own.is_empty() { 0 } else { GAPS[1] };
    let size = [grid[0].max(below), grid[1] + own.len() * row + last];
    let mut sheet = Image::new(size[0], size[1], 3).map(|_| 1.0);
    for (c, context) in contexts.iter().enumerate() {
        let x = left + c * group;
        font::draw(&mut sheet, [x, GAPS[1]], &context.to_string(), SCALE, 0.1);
        for (r, regime) in regimes.iter().enumerate() {
            let y = top + r * (height + GAPS[0]);
            if c == 0 {
                font::draw(&mut sheet, [GAPS[1], y + (height - line) / 2], &regime.to_string(), SCALE, 0.1);
            }
            let these = pictures.get(&Stratum { regime: *regime, context: *context }.into());
            for (k, image) in these.into_iter().flatten().enumerate() {
                paste(&mut sheet, image, [x + k * (width + GAPS[0]), y], 1);
            }
        }
    }
    for (r, (name, images)) in own.into_iter().enumerate() {
        let y = grid[1] + r * row + GAPS[1];
        font::draw(&mut sheet, [left, y], name.as_str(), SCALE, 0.1);
        for (k, image) in images.iter().enumerate() {
            paste(&mut sheet, image, [left + k * (width + GAPS[0]), y + line + GAPS[1]], 1);
        }
    }
    sheet
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pictures_are_where_their_strata_say() {
        let grey = |value: f32| Image::new(8, 30, 3).map(|_| value);
        let stratum = |regime, context| StratumName::from(Stratum { regime, context });
        let pictures = BTreeMap::from([
            (stratum(Regime::L0, ContextClass::Open), vec![grey(0.25), grey(0.5)]),
            (stratum(Regime::L3, ContextClass::Enclosed), vec![grey(0.75)]),
        ]);
        let own = BTreeMap::from([("a".parse().expect("a name"), vec![grey(0.25), grey(0.5)])]);
        let below = pictures.iter().chain(&own).map(|(name, images)| (name.clone(), images.clone())).collect();
        let (own, below, sheet) = (sheet(&own, 2), sheet(&below, 2), sheet(&pictures, 2));
        let (left, top) = (font::width("L0", 2) + 28, 16 + 28);
        let group = 2 * 8 + 3 + 14;
        assert_eq!((sheet.width(), sheet.height()), (left + 2 * group, top + 63 + 14));
        assert_eq!(sheet.pixel(left, top)[0], 0.25);
        assert_eq!(sheet.pixel(left + 11, top + 29)[0], 0.5);
        assert_eq!(sheet.pixel(left + group, top + 33)[0], 0.75);
        // Own strata stand below, and alone where there are no others.
        let first = 14 + 16 + 14;
        assert_eq!((below.width(), below.height()), (sheet.width(), sheet.height() + first + 30 + 14));
        assert_eq!((below.pixel(left, top)[0], below.pixel(left + 11, sheet.height() + first)[0]), (0.25, 0.5));
        assert_eq!((own.height(), own.pixel(left, first)[0]), (first + 30 + 14, 0.25));
        // Missing pictures are left white.
        assert_eq!(sheet.pixel(left, top + 33)[0], 1.0);
    }
}
