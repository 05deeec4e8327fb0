//! Stuffs of things: forms and layouts name them, and materials turn them into surfaces.

/// The stuff of a part.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Stuff {
    /// Sawn and planed wood, with grain along u.
    Wood,
    /// Bark of a trunk or branch.
    Bark,
    /// Natural stone.
    Stone,
    /// Concrete.
    Concrete,
    /// Bricks in mortar.
    Brick,
    /// Painted plaster.
    Plaster,
    /// Ceramic tiles in grout.
    Tile,
    /// Wallpaper with a printed pattern.
    Wallpaper,
    /// Woven fabric.
    Fabric,
    /// Thick pile: carpets and rugs.
    Carpet,
    /// Leather.
    Leather,
    /// Paper and card.
    Paper,
    /// A printed surface: covers, labels, posters, pictures, text.
    Print,
    /// Metal, brushed or scratched.
    Metal,
    /// Painted metal.
    PaintedMetal,
    /// Plastic.
    Plastic,
    /// Rubber.
    Rubber,
    /// Glazed ceramic.
    Ceramic,
    /// Unglazed clay.
    Clay,
    /// Window glass and other thin panes, as a single sheet.
    Pane,
    /// Solid glass, as a closed body.
    Glass,
    /// A mirror.
    Mirror,
    /// Water, as a surface or a closed body.
    Water,
    /// Leaves and petals, thin sheets.
    Leaf,
    /// Blades of grass.
    Grass,
    /// Soil.
    Soil,
    /// Sand and gravel.
    Sand,
    /// Asphalt and paving.
    Asphalt,
    /// Snow.
    Snow,
    /// Wax and soap.
    Wax,
    /// Skin of fruit and other food.
    Food,
    /// Something that glows by itself: bulbs, tubes, shades lit from within.
    Glow,
    /// A lit screen.
    Screen,
}
