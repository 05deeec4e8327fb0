//! Reader of glTF 2.0 objects (`.gltf`, `.glb`): every index, length and type is checked before it is used.

mod accessor;
mod container;
mod deform;
mod draco;
mod finish;
mod glossiness;
mod images;
mod material;
mod object;
mod pose;
mod primitive;
mod purpose;
mod slots;
mod textures;
mod two_sided;
mod uv_sets;

pub use container::Document;
pub use container::{Externals, relative_path, uris};
pub use images::{alpha, picture};
pub use object::{Surfaces, read, read_in_place};
