//! Collects the bodies of a thing into parts, with tops and solids. Knows no thing in particular.

use super::{
    super::{shapes::Body, stuff::Stuff},
    FormVariant, Part, Top, cover,
};
use tauflow_data::geom::{Aabb, Vec3, add, sub};
use tauflow_data::mesh::Mesh;

/// A thing in the making. Bodies may lie anywhere: [`Maker::made`] sets the foot on y = 0 and centres x and z.
#[derive(Default)]
pub struct Maker {
    groups: Vec<(Stuff, Vec<Body>)>,
    tops: Vec<Top>,
    boxes: Vec<Aabb>,
    count: u64,
}

impl Maker {
    /// Adds a body to the last part of this stuff, or begins one.
    pub fn add(&mut self, stuff: Stuff, body: Body) {
        self.boxes.extend(cover::boxes(&body));
        let body = self.shifted(stuff, body);
        match self.groups.iter_mut().rev().find(|(s, _)| *s == stuff) {
            Some((_, bodies)) => bodies.push(body),
            None => self.groups.push((stuff, vec![body])),
        }
    }

    /// Adds a body as the beginning of a part of its own, which may get another colour.
    pub fn another(&mut self, stuff: Stuff, body: Body) {
        self.boxes.extend(cover::boxes(&body));
        let body = self.shifted(stuff, body);
        self.groups.push((stuff, vec![body]));
    }

    /// [`Maker::another`] for the first of several bodies, [`Maker::add`] for the rest.
    pub fn another_of(&mut self, stuff: Stuff, first: bool, body: Body) {
        if first { self.another(stuff, body) } else { self.add(stuff, body) }
    }

    /// Pieces of natural stuff do not show the same piece of pattern.
    fn shifted(&mut self, stuff: Stuff, mut body: Body) -> Body {
        self.count += 1;
        if matches!(stuff, Stuff::Wood | Stuff::Stone | Stuff::Bark | Stuff::Concrete | Stuff::Fabric) {
            let by = [0.377, 0.619].map(|step| (step * self.count as f64) % 1.0);
            body.uvs.iter_mut().for_each(|uv| *uv = [uv[0] + by[0], uv[1] + by[1]]);
        }
        body
    }

    /// The bodies so far with their stuff, for a thing that is part of another.
    pub fn bodies(self) -> Vec<(Stuff, Body)> {
        self.groups.into_iter().flat_map(|(stuff, bodies)| bodies.into_iter().map(move |body| (stuff, body))).collect()
    }

    /// A flat place at `center`, half size along x and z, with free height above it.
    pub fn top(&mut self, center: Vec3, half: [f64; 2], clearance: f64) {
        self.tops.push(Top { center, half, clearance });
    }

    /// Height of the first flat place so far; 0 where there is none.
    pub fn tops_height(&self) -> f64 {
        self.tops.first().map_or(0.0, |top| top.center[1])
    }

    /// Forgets the flat places so far: something covers them.
    pub fn tops_clear(&mut self) {
        self.tops.clear();
    }

    /// The thing, set on its foot.
    pub fn made(self) -> FormVariant {
        let mut bounds = Aabb::EMPTY;
        self.groups.iter().flat_map(|(_, b)| b).flat_map(|b| &b.points).for_each(|p| bounds.grow(*p));
        let center = bounds.center();
        let by = [-center[0], -bounds.low[1], -center[2]];
        let parts: Vec<Part> = self
            .groups
            .into_iter()
            .map(|(stuff, bodies)| {
                let meshes: Vec<Mesh> = bodies.iter().map(|b| b.mesh(by)).collect();
                Part { mesh: joined(&meshes), stuff }
            })
            .collect();
        let half = [0.5 * bounds.size()[0], 0.5 * bounds.size()[2]];
        let moved = |b: Aabb| Aabb { low: add(b.low, by), high: add(b.high, by) };
        FormVariant {
            parts,
            bounds: Aabb { low: [-half[0], 0.0, -half[1]], high: [half[0], sub(bounds.high, bounds.low)[1], half[1]] },
            tops: self.tops.into_iter().map(|t| Top { center: add(t.center, by), ..t }).collect(),
            solids: cover::merged(self.boxes).into_iter().map(moved).collect(),
        }
    }
}

fn joined(meshes: &[Mesh]) -> Mesh {
    let mut out = Mesh { normals: Some(Vec::new()), uvs: Some(Vec::new()), ..Mesh::default() };
    for mesh in meshes {
        let base = out.positions.len() as u32;
        out.positions.extend(&mesh.positions);
        out.triangles.extend(mesh.triangles.iter().map(|t| t.map(|i| i + base)));
        if let (Some(all), Some(own)) = (&mut out.normals, &mesh.normals) {
            all.extend(own);
        }
        if let (Some(all), Some(own)) = (&mut out.uvs, &mesh.uvs) {
            all.extend(own);
        }
    }
    out
}

/// A thing of one body.
pub fn one(stuff: Stuff, body: Body) -> FormVariant {
    let mut m = Maker::default();
    m.add(stuff, body);
    m.made()
}
