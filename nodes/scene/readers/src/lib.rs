//! Reads other people's files: single assets, and whole scenes.
//!
//! Knows the formats, and nothing of how scenes are generated, rendered or judged.

mod assets;
mod scene_files;

pub use assets::{Assets, AssetsParams};
pub use scene_files::{
    LightUnit, Loaded, Options, SceneFiles, SceneFilesParams, ScenePath, Setting, View, check_scene, environment_map,
    load_scene, load_scene_in,
};

use tauflow_contract::{KindRow, NodeKind};

/// The kinds of this crate.
pub fn kinds() -> Vec<Box<dyn NodeKind>> {
    vec![Box::new(KindRow::<Assets>::new()), Box::new(KindRow::<SceneFiles>::new())]
}
