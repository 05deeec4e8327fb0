//! How lobes of materials and lights are chosen.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// How lobes of `principled` materials and lights are chosen. The expected image is the same.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Choices {
    /// Highlights as often as if they reflected all light; lights by what they would bring if nothing stood in between.
    Fixed,
    /// Lobes about in proportion to the light that they reflect; lights by what arrives, as a few paths find out before
    /// the render.
    #[default]
    Adapted,
}
