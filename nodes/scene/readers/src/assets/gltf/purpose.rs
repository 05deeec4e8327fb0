//! The uses of a file.

/// The use of a file, which determines its omitted parts.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Purpose {
    /// An object to put into scenes: it brings no lights, and its size is that of most of it.
    Object,
    /// A scene: the caller reads its lights and cameras.
    Scene,
}
