//! The layouts: places as the world has them, each with things of its own.
//!
//! Metres. Powers are relative: exposure is set afterwards, scene by scene.

mod arches;
mod back_rooms;
mod displays;
mod gardens;
mod grounds;
mod halls;
mod homes;
mod kit;
mod nature;
mod public;
mod shops;
mod tables;
mod town;
mod work;

use super::{
    cast::Cast,
    stage::{From, Stage},
};
use tauflow_data::{ContextClass, Regime, Stratum, geom::Aabb, rng::Stream};

/// A layout: fills a stage.
pub type Layout = (&'static str, fn(&mut Stage<'_>));

/// Under the sky alone.
pub const ENVIRONMENT: &[Layout] = &[
    ("car_park", grounds::car_park),
    ("chess_board", displays::chess_board),
    ("forest_clearing", nature::forest_clearing),
    ("hedge_garden", gardens::hedge_garden),
    ("hills", nature::hills),
    ("lake_shore", nature::lake_shore),
    ("meadow", nature::meadow),
    ("picnic", gardens::picnic),
    ("playground", grounds::playground),
    ("pool", gardens::pool),
    ("product_shot", displays::product_shot),
    ("rocks_on_sand", nature::rocks_on_sand),
    ("roof_terrace", grounds::roof_terrace),
    ("sculpture_park", gardens::sculpture_park),
];

/// In the open: sky and lamps, and walls that throw light at each other.
pub const OPEN: &[Layout] = &[
    ("arcade", arches::arcade),
    ("balcony", arches::balcony),
    ("bridge", arches::bridge),
    ("bus_stop", town::bus_stop),
    ("cafe_terrace", shops::cafe_terrace),
    ("colonnade", arches::colonnade),
    ("construction_site", grounds::construction_site),
    ("courtyard", town::courtyard),
    ("fountain", town::fountain),
    ("market_stall", shops::market_stall),
    ("pergola", displays::pergola),
    ("shop_window", shops::shop_window),
    ("street", town::street),
    ("underpass", arches::underpass),
];

/// In rooms.
pub const ENCLOSED: &[Layout] = &[
    ("attic", back_rooms::attic),
    ("bathroom", back_rooms::bathroom),
    ("bedroom", homes::bedroom),
    ("bookshelf", tables::bookshelf),
    ("cafe", shops::cafe),
    ("cellar", back_rooms::cellar),
    ("classroom", work::classroom),
    ("corridor", halls::corridor),
    ("dining_room", homes::dining_room),
    ("dinner_table", tables::dinner_table),
    ("gallery", public::gallery),
    ("garage", work::garage),
    ("glass_table", displays::glass_table),
    ("greenhouse", halls::greenhouse),
    ("hotel_lobby", public::hotel_lobby),
    ("jeweller", shops::jeweller),
    ("kitchen", homes::kitchen),
    ("kitchen_counter", tables::kitchen_counter),
    ("library_aisle", halls::library_aisle),
    ("living_room", homes::living_room),
    ("metal_ring", displays::metal_ring),
    ("museum_case", public::museum_case),
    ("office_desk", work::office_desk),
    ("prism", displays::prism),
    ("stairwell", halls::stairwell),
    ("still_life", tables::still_life),
    ("study", homes::study),
    ("swimming_hall", public::swimming_hall),
    ("toy_shelf", tables::toy_shelf),
    ("window_sill", tables::window_sill),
    ("workshop", work::workshop),
];

/// The layouts of a context.
pub fn layouts(context: ContextClass) -> &'static [Layout] {
    match context {
        ContextClass::Environment => ENVIRONMENT,
        ContextClass::Open => OPEN,
        ContextClass::Enclosed => ENCLOSED,
    }
}

/// A stage of a random layout for `most` things at most.
pub fn build<'a>(stratum: Stratum, cast: &'a Cast<'a>, stream: &Stream, most: usize) -> Stage<'a> {
    let choices = layouts(stratum.context);
    stage(choices[stream.part("template").below(choices.len())], stratum, cast, stream, most)
}

/// A stage of a layout.
pub fn stage<'a>(
    (name, layout): Layout,
    stratum: Stratum,
    cast: &'a Cast<'a>,
    stream: &Stream,
    most: usize,
) -> Stage<'a> {
    let mut stage = Stage::new(name, stratum, cast, stream, most);
    match stratum.context {
        ContextClass::Environment => stage.sky = 1.0,
        ContextClass::Open => stage.sky = stage.draw("sky", 0.1, 0.35),
        ContextClass::Enclosed => {}
    }
    layout(&mut stage);
    // People look at what shows: the more so, the smaller what the regime is about.
    let shown: Vec<Aabb> = stage.things.iter().filter(|t| t.special && t.main).map(|t| t.bounds).collect();
    let total: f64 = stage.eyes.iter().map(|e| e.weight).sum();
    let (share, far) = match stratum.regime {
        Regime::L0 | Regime::L1 => (0.2, 6.0),
        Regime::L2 => (0.9, 6.0),
        // Caustics are as small as what casts them.
        Regime::L3 => (3.0, 3.5),
    };
    let share = share * total.max(1.0);
    for bounds in &shown {
        let size = bounds.size();
        let longest = size[0].max(size[1]).max(size[2]);
        let from = From::Orbit([2.2 * longest, far * longest], stage.front, [0.1, 0.75]);
        stage.eye(share / shown.len() as f64, from, Aabb::around(bounds.center(), size.map(|s| 0.3 * s)));
    }
    stage
}
