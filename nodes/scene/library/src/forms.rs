//! The library of procedural things: each form in a number of fixed variants, at its real size.
//!
//! Metres, y up, foot on y = 0, centred in x and z. Variants come from the library, not from the scene's seed, so that
//! thirty thousand scenes share a few thousand meshes and an object's name says what it is. Knows no material beyond
//! [`Stuff`], and no scene.

mod beds;
mod bicycles;
mod bins;
mod boxes;
mod castings;
mod ceiling_lamps;
mod clocks;
mod columns;
mod cover;
mod desktop;
mod fences;
mod food;
mod frames;
mod grass;
mod ground;
mod instruments;
mod lamps;
mod machine;
mod maker;
mod openings;
mod ornaments;
mod potted;
mod sculptures;
mod seats;
mod signs;
mod sofas;
mod solids;
mod stairs;
mod storage;
mod street;
mod tables;
mod tableware;
mod tools;
mod toys;
mod trees;
mod vehicles;
mod vessels;

use super::stuff::Stuff;
use std::sync::LazyLock;
use tauflow_data::geom::{Aabb, Vec3};
use tauflow_data::{mesh::Mesh, rng::Stream};

/// The family of a form; layouts request families.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Family {
    /// Chairs and stools for one.
    Chair,
    /// Sofas, armchairs, ottomans.
    Sofa,
    /// Tables to stand at or sit round.
    Table,
    /// Desks to work at.
    Desk,
    /// Open shelves.
    Shelf,
    /// Closed furniture: cabinets, chests, wardrobes, lockers.
    Cabinet,
    /// Beds.
    Bed,
    /// Lamps that stand on something, candles and lanterns too.
    Lamp,
    /// Lamps that hang: their highest point is where they are fixed.
    CeilingLamp,
    /// Screens: monitors, laptops, telephones.
    Screen,
    /// Books, alone, in rows and piles.
    Book,
    /// Sheets, stacks, crumpled paper, envelopes.
    Paper,
    /// Pens, pencils, and pots of them.
    Pen,
    /// Cups, bottles, vases, bowls, jars.
    Vessel,
    /// Plates and trays.
    Plate,
    /// Fruit, bread, cake.
    Food,
    /// Plants in pots.
    Plant,
    /// Trees.
    Tree,
    /// Bushes and hedges.
    Bush,
    /// Tufts and patches of grass, reeds.
    Grass,
    /// Loose leaves and twigs.
    Leaves,
    /// Rocks and pebbles.
    Rock,
    /// Pieces of ground.
    Terrain,
    /// Cloth that is draped, folded or hung.
    Cloth,
    /// Rugs and mats.
    Rug,
    /// Curtains.
    Curtain,
    /// Blinds.
    Blind,
    /// Cushions and pillows.
    Cushion,
    /// Boxes, crates, baskets, barrels, suitcases.
    Box,
    /// Tools.
    Tool,
    /// Gears, flanges, pipes, bolts.
    MachinePart,
    /// Fences.
    Fence,
    /// Rails, balustrades, bollards.
    Rail,
    /// Columns, obelisks, arches.
    Column,
    /// Stairs and ladders.
    Stair,
    /// Statues and abstract sculptures.
    Sculpture,
    /// Toys and games.
    Toy,
    /// Signs and letters.
    Sign,
    /// Vehicles.
    Vehicle,
    /// Bins.
    Bin,
    /// Benches.
    Bench,
    /// Street lamps.
    StreetLamp,
    /// Ornaments: candlesticks, trophies, shells.
    Ornament,
    /// Musical instruments.
    Instrument,
    /// Clocks.
    Clock,
    /// Framed pictures and mirrors; they look along +z and hang or lean.
    Frame,
    /// Bicycles and scooters.
    Bicycle,
    /// Cutlery, pans, pots.
    Utensil,
    /// Simple solids and gems.
    Solid,
    /// Doors and windows with their frames; they look along +z.
    Opening,
    /// Radiators, taps, basins.
    Fixture,
}

/// A form of the library.
#[derive(Clone, Copy)]
pub struct Form {
    /// Its name.
    pub name: &'static str,
    /// Its family.
    pub family: Family,
    /// How many variants there are.
    pub variants: u64,
    /// True if it is one closed body that solid glass suits.
    pub glass: bool,
    make: fn(&mut Stream) -> FormVariant,
}

/// A part of a made form: a surface of one stuff.
#[derive(Clone, Debug)]
pub struct Part {
    /// Closed, or a thin sheet; normals outwards; uv in metres along the surface, v downwards.
    pub mesh: Mesh,
    /// Its material.
    pub stuff: Stuff,
}

/// A flat place that things can stand on.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Top {
    /// Its middle.
    pub center: Vec3,
    /// Half its size along x and z.
    pub half: [f64; 2],
    /// Free height above it; infinite under the open sky.
    pub clearance: f64,
}

/// A variant of a form.
#[derive(Clone, Debug)]
pub struct FormVariant {
    /// Its parts, at least one.
    pub parts: Vec<Part>,
    /// The box around it: foot on y = 0, x and z centred.
    pub bounds: Aabb,
    /// Flat places things can stand on.
    pub tops: Vec<Top>,
    /// Boxes that together contain it, tightly: of a table four legs and a board.
    pub solids: Vec<Aabb>,
}

const fn form(name: &'static str, family: Family, variants: u64, make: fn(&mut Stream) -> FormVariant) -> Form {
    Form { name, family, variants, glass: false, make }
}

/// A form of one closed body that solid glass suits.
const fn solid(name: &'static str, family: Family, variants: u64, make: fn(&mut Stream) -> FormVariant) -> Form {
    Form { name, family, variants, glass: true, make }
}

static FORMS: LazyLock<Vec<Form>> = LazyLock::new(|| {
    let mut forms: Vec<Form> = [
        beds::FORMS,
        bicycles::FORMS,
        bins::FORMS,
        boxes::FORMS,
        castings::FORMS,
        ceiling_lamps::FORMS,
        clocks::FORMS,
        columns::FORMS,
        desktop::FORMS,
        fences::FORMS,
        food::FORMS,
        frames::FORMS,
        grass::FORMS,
        ground::FORMS,
        instruments::FORMS,
        lamps::FORMS,
        machine::FORMS,
        openings::FORMS,
        ornaments::FORMS,
        potted::FORMS,
        sculptures::FORMS,
        seats::FORMS,
        signs::FORMS,
        sofas::FORMS,
        solids::FORMS,
        stairs::FORMS,
        storage::FORMS,
        street::FORMS,
        tables::FORMS,
        tableware::FORMS,
        tools::FORMS,
        toys::FORMS,
        trees::FORMS,
        vehicles::FORMS,
        vessels::FORMS,
    ]
    .into_iter()
    .flatten()
    .copied()
    .collect();
    forms.sort_by_key(|form| form.name);
    forms
});

/// Every form, sorted by name.
pub fn forms() -> &'static [Form] {
    &FORMS
}

/// The forms of a family, sorted by name.
#[cfg(test)]
pub fn of_family(family: Family) -> impl Iterator<Item = &'static Form> {
    forms().iter().filter(move |form| form.family == family)
}

impl Form {
    /// A variant: the same bits for the same name and variant. Those from `variants` on are of other libraries.
    pub fn make(&self, variant: u64) -> FormVariant {
        (self.make)(&mut Stream::new(0x666F_726D, &[variant]).part(self.name))
    }
}

#[cfg(test)]
mod tests;
