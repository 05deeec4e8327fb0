//! The default pose: which meshes a file's default scene shows, where their copies stand, and where its joints are.
//! Knows nothing of what meshes hold.
//!
//! Sources: glTF 2.0, sections 3.5 (scenes, nodes, transforms) and 3.7.3 (skins); `EXT_mesh_gpu_instancing`.

use super::{
    accessor::{self, Values},
    container::Document,
    purpose::Purpose,
};
use crate::assets::{
    bounds,
    refusal::{Refusal, damaged},
};
use gltf::json::{Index, scene::Node};
use serde_json::Value;
use std::collections::{BTreeMap, BTreeSet};
use tauflow_data::{
    geom::{Vec3, compose},
    records::AssetReport,
    scene::{Affine, IDENTITY},
};

/// A mesh where it stands.
pub struct Instance {
    /// The mesh.
    pub mesh: usize,
    /// Where its copies stand, by node. The joints of a skinned mesh determine it.
    pub copies: Vec<Copies>,
    /// The skin.
    pub skin: Option<usize>,
    /// Weights of the morph targets; those beyond its end are 0.
    pub weights: Vec<f64>,
}

/// Where copies of a mesh stand: one at its node, or those of `EXT_mesh_gpu_instancing`.
pub struct Copies {
    node: usize,
    map: Affine,
    count: usize,
    translations: Option<Values>,
    rotations: Option<Values>,
    scales: Option<Values>,
}

/// The default pose of a file.
pub struct Pose {
    /// The meshes it shows.
    pub instances: Vec<Instance>,
    /// Transform of each node that is known so far.
    globals: Vec<Option<Affine>>,
    /// Parent of each node, if that was asked for.
    parents: Option<Vec<Option<usize>>>,
    /// Matrices of the skins that were asked for.
    skins: BTreeMap<usize, Vec<Affine>>,
}

const INSTANCING: &str = "EXT_mesh_gpu_instancing";

impl Copies {
    /// How many there are.
    pub fn len(&self) -> usize {
        self.count
    }

    /// Where copy `i` stands.
    ///
    /// # Errors
    /// If that is not finite.
    pub fn map(&self, i: usize) -> Result<Affine, Refusal> {
        let attribute = |values: &Option<Values>, default: f64| match values {
            Some(values) => std::array::from_fn(|c| values.data[i * values.width + c]),
            None => [default; 3],
        };
        let rotation = match &self.rotations {
            Some(values) => std::array::from_fn(|c| values.data[i * 4 + c]),
            None => [0.0, 0.0, 0.0, 1.0],
        };
        let own = placed(attribute(&self.translations, 0.0), rotation, attribute(&self.scales, 1.0));
        let map = if self.is_plain() { self.map } else { compose(&self.map, &own) };
        if map.iter().flatten().all(|v| v.is_finite()) {
            return Ok(map);
        }
        Err(damaged(format!("node {} instance {i}", self.node), "its transform is not finite"))
    }

    /// True for one copy that stands at its node.
    fn is_plain(&self) -> bool {
        self.translations.is_none() && self.rotations.is_none() && self.scales.is_none()
    }

    /// The copies of a node, of which `left` may still be.
    fn of(
        document: &Document<'_>,
        number: usize,
        node: &Node,
        map: Affine,
        left: &mut usize,
        report: &mut AssetReport,
    ) -> Result<Self, Refusal> {
        let mut copies = Self { node: number, map, count: 1, translations: None, rotations: None, scales: None };
        let Some(extension) = node.extensions.as_ref().and_then(|e| e.others.get(INSTANCING)) else {
            return Ok(copies);
        };
        let place = format!("node {number} {INSTANCING}");
        let attributes = extension.get("attributes").and_then(Value::as_object);
        let attributes = attributes.ok_or_else(|| damaged(&place, "it has no attributes"))?;
        let mut count = None;
        for (name, accessor) in attributes {
            let index = accessor.as_u64().and_then(|i| usize::try_from(i).ok()).unwrap_or(usize::MAX);
            let here = accessor::count(document, index)?;
            if count.is_some_and(|count| count != here) {
                return Err(damaged(place, format!("{here} elements of one attribute, another number of others")));
            }
            count = Some(here);
            let (values, width) = match name.as_str() {
                "TRANSLATION" => (&mut copies.translations, 3),
                "ROTATION" => (&mut copies.rotations, 4),
                "SCALE" => (&mut copies.scales, 3),
                _ => {
                    report.note("attributes of instances beside translation, rotation and scale are left out");
                    continue;
                }
            };
            if here > *left {
                return Err(Refusal::new(
                    place,
                    format!(
                        "{here} instances: with those before more than {}, the most for a file of {} bytes",
                        bounds::instances(document.bytes()),
                        document.bytes()
                    ),
                    "export fewer instances, or several of them as one mesh",
                ));
            }
            let read = accessor::values(document, index)?;
            if read.width != width {
                return Err(damaged(format!("{place} {name}"), format!("vectors of {} numbers", read.width)));
            }
            *values = Some(read);
        }
        if copies.is_plain() {
            // Instances that differ in nothing else are one.
            report.repaired("instances in one place left out", count.unwrap_or(1).saturating_sub(1) as u64);
        } else {
            copies.count = count.unwrap_or(0);
            *left -= copies.count;
        }
        Ok(copies)
    }
}

impl Pose {
    /// Walks the default scene.
    ///
    /// # Errors
    /// If a node is not there, is its own ancestor, has two parents or no finite transform, or stands for too many
    /// instances.
    pub fn of(document: &Document<'_>, purpose: Purpose, report: &mut AssetReport) -> Result<Self, Refusal> {
        let root = &document.root;
        let mut seen: Vec<Option<Affine>> = vec![None; root.nodes.len()];
        let mut instances = Vec::new();
        let (mut left, mut skinned, mut coincident) = (bounds::instances(document.bytes()), BTreeSet::new(), 0);
        let mut stack: Vec<(usize, Affine)> = roots(document)?.into_iter().rev().map(|n| (n, IDENTITY)).collect();
        while let Some((number, above)) = stack.pop() {
            let place = format!("node {number}");
            let node = root.nodes.get(number).ok_or_else(|| damaged(&place, "there is no such node"))?;
            let map = compose(&above, &local(node));
            // A node has one parent, so being seen twice means a loop or two parents.
            if seen[number].replace(map).is_some() {
                return Err(damaged(place, "it is its own ancestor, or a child of two nodes"));
            }
            if !map.iter().flatten().all(|v| v.is_finite()) {
                return Err(damaged(place, "its transform is not finite"));
            }
            let shines = node.extensions.as_ref().is_some_and(|e| e.others.contains_key("KHR_lights_punctual"));
            if shines && purpose == Purpose::Object {
                report.note("lights are left out");
            }
            if let Some(mesh) = node.mesh.map(|mesh| mesh.value()) {
                let copies = Copies::of(document, number, node, map, &mut left, report)?;
                let weights = weights(document, node, mesh)?;
                let skin = node.skin.map(|skin| skin.value());
                let bits: Vec<u64> = weights.iter().map(|w| w.to_bits()).collect();
                // A skinned mesh stands where its joints are, whatever its node (section 3.7.3.3).
                if skin.is_some_and(|skin| !skinned.insert((mesh, skin, bits))) {
                    coincident += 1;
                } else {
                    instances.push(Instance { mesh, copies: vec![copies], skin, weights });
                }
            }
            stack.extend(node.children.iter().flatten().rev().map(|child| (child.value(), map)));
        }
        report.repaired("copies of a skinned mesh on the same joints left out", coincident);
        Ok(Self { instances, globals: seen, parents: None, skins: BTreeMap::new() })
    }

    /// The transform of a vertex by each joint of a skin: the joint's transform after its inverse bind matrix.
    ///
    /// # Errors
    /// If the skin or a joint is not there, a joint is its own ancestor, or a matrix is missing or not finite.
    pub fn skin(
        &mut self,
        document: &Document<'_>,
        number: usize,
        report: &mut AssetReport,
    ) -> Result<&[Affine], Refusal> {
        if !self.skins.contains_key(&number) {
            let made = self.joints(document, number, report)?;
            self.skins.insert(number, made);
        }
        Ok(&self.skins[&number])
    }

    fn joints(
        &mut self,
        document: &Document<'_>,
        number: usize,
        report: &mut AssetReport,
    ) -> Result<Vec<Affine>, Refusal> {
        let place = format!("skin {number}");
        let skin = document.root.skins.get(number).ok_or_else(|| damaged(&place, "there is no such skin"))?;
        let inverse = match skin.inverse_bind_matrices {
            None => None,
            Some(index) => {
                let values = accessor::values(document, index.value())?;
                if values.width != 16 || values.len() < skin.joints.len() {
                    let what = format!("{} inverse bind matrices for {} joints", values.len(), skin.joints.len());
                    let what = if values.width == 16 { what } else { "inverse bind matrices that are none".to_owned() };
                    return Err(damaged(place, what));
                }
                Some(values)
            }
        };
        let mut flat = true;
        let mut out = Vec::with_capacity(skin.joints.len());
        for (k, joint) in skin.joints.iter().enumerate() {
            let global = self.global(document, joint.value())?;
            let matrix = match &inverse {
                None => global,
                Some(values) => {
                    let m = &values.data[16 * k..16 * (k + 1)];
                    flat &= [m[3], m[7], m[11], m[15] - 1.0].iter().all(|v| v.abs() < 1e-3);
                    compose(&global, &columns(m))
                }
            };
            if !matrix.iter().flatten().all(|v| v.is_finite()) {
                return Err(damaged(format!("{place} joint {k}"), "its matrix is not finite"));
            }
            out.push(matrix);
        }
        if !flat {
            report.note("last rows of inverse bind matrices that are not 0 0 0 1 are taken for it");
        }
        Ok(out)
    }

    /// The transform of a node, which the default scene need not show.
    fn global(&mut self, document: &Document<'_>, number: usize) -> Result<Affine, Refusal> {
        let nodes = &document.root.nodes;
        let (mut chain, mut at) = (Vec::new(), Some(number));
        let mut map = IDENTITY;
        while let Some(node) = at {
            if node >= nodes.len() {
                return Err(damaged(format!("node {node}"), "there is no such node"));
            }
            if let Some(known) = self.globals[node] {
                map = known;
                break;
            }
            if chain.len() > nodes.len() {
                return Err(damaged(format!("node {number}"), "it is its own ancestor"));
            }
            chain.push(node);
            if self.parents.is_none() {
                self.parents = Some(parents(nodes)?);
            }
            at = self.parents.as_ref().and_then(|parents| parents[node]);
        }
        for node in chain.into_iter().rev() {
            map = compose(&map, &local(&nodes[node]));
            self.globals[node] = Some(map);
        }
        Ok(map)
    }
}

/// The nodes that the default scene begins with.
fn roots(document: &Document<'_>) -> Result<Vec<usize>, Refusal> {
    let root = &document.root;
    let number = root.scene.map_or(0, |s| s.value());
    match root.scenes.get(number) {
        Some(scene) => Ok(scene.nodes.iter().map(Index::value).collect()),
        None if root.scenes.is_empty() => {
            // Without scenes: every node that is nobody's child.
            let children: BTreeSet<usize> =
                root.nodes.iter().flat_map(|n| n.children.iter().flatten().map(Index::value)).collect();
            Ok((0..root.nodes.len()).filter(|n| !children.contains(n)).collect())
        }
        None => Err(damaged("scene", format!("scene {number} is not there"))),
    }
}

/// The parent of each node.
fn parents(nodes: &[Node]) -> Result<Vec<Option<usize>>, Refusal> {
    let mut out = vec![None; nodes.len()];
    for (parent, node) in nodes.iter().enumerate() {
        for child in node.children.iter().flatten().map(Index::value) {
            let place = out.get_mut(child).ok_or_else(|| damaged(format!("node {child}"), "there is no such node"))?;
            if place.replace(parent).is_some() {
                return Err(damaged(format!("node {child}"), "it is its own ancestor, or a child of two nodes"));
            }
        }
    }
    Ok(out)
}

/// Weights of morph targets: the node's, or its mesh's.
fn weights(document: &Document<'_>, node: &Node, mesh: usize) -> Result<Vec<f64>, Refusal> {
    let of_mesh = || document.root.meshes.get(mesh)?.weights.as_ref();
    let Some(weights) = node.weights.as_ref().or_else(of_mesh) else { return Ok(Vec::new()) };
    if let Some(at) = weights.iter().position(|w| !w.is_finite()) {
        return Err(damaged(format!("mesh {mesh}"), format!("the weight of morph target {at} is not finite")));
    }
    Ok(weights.iter().map(|w| f64::from(*w)).collect())
}

/// The rows of a matrix that is stored by columns, without the last one.
fn columns(m: &[f64]) -> Affine {
    [0, 1, 2].map(|r| [m[r], m[4 + r], m[8 + r], m[12 + r]])
}

/// A node's own transform: its matrix, or scale, then rotation, then translation.
fn local(node: &Node) -> Affine {
    if let Some(m) = &node.matrix {
        return columns(&m.map(f64::from));
    }
    let t = node.translation.unwrap_or([0.0; 3]).map(f64::from);
    let s = node.scale.unwrap_or([1.0; 3]).map(f64::from);
    placed(t, node.rotation.map_or([0.0, 0.0, 0.0, 1.0], |q| q.0.map(f64::from)), s)
}

/// Scale, then rotation by a quaternion, then translation.
fn placed(t: Vec3, [x, y, z, w]: [f64; 4], s: Vec3) -> Affine {
    // Files hold quaternions to f32 or less: this form is a rotation for any length but 0.
    let n = x * x + y * y + z * z + w * w;
    let k = if n > 0.0 { 2.0 / n } else { 0.0 };
    let rows = [
        [1.0 - k * (y * y + z * z), k * (x * y - z * w), k * (x * z + y * w)],
        [k * (x * y + z * w), 1.0 - k * (x * x + z * z), k * (y * z - x * w)],
        [k * (x * z - y * w), k * (y * z + x * w), 1.0 - k * (x * x + y * y)],
    ];
    [0, 1, 2].map(|r| [rows[r][0] * s[0], rows[r][1] * s[1], rows[r][2] * s[2], t[r]])
}
