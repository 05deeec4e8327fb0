//! Reader of glTF 2.0 objects (`.gltf`, `.glb`): every index, length and type is checked before it is used.

mod accessor;
mod container;
mod draco;
mod finish;
mod images;
mod material;
mod object;
mod primitive;
mod slots;

pub use container::Document;
pub use container::{Externals, relative_path, uris};
pub use images::picture;
pub use object::{read, read_in_place};
