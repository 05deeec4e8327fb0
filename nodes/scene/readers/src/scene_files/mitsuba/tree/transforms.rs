//! Transforms of elements: one step after another, the last one leftmost.

use super::{
    super::values::{any_up, look, numbers, rotate},
    Element, Lines, Parser, Place, Transform,
};
use crate::scene_files::build::chained;
use tauflow_data::{
    geom::{Vec3, scaling, sub, translation, unit},
    scene::IDENTITY,
};

impl Parser<'_> {
    pub(super) fn triple(&mut self, element: Element<'_, '_>, name: &str, at: &Place) -> Option<Vec3> {
        let text = self.needed(element, name, at)?;
        match numbers(&text).as_deref() {
            Some([x, y, z]) => Some([*x, *y, *z]),
            _ => {
                self.problems.error(at, format!("`{name}` is `{text}`"), "write three numbers");
                None
            }
        }
    }

    /// The attributes x, y and z.
    pub(super) fn axes(&mut self, element: Element<'_, '_>, default: f64, at: &Place) -> Option<Vec3> {
        let mut out = [default; 3];
        for (value, name) in out.iter_mut().zip(["x", "y", "z"]) {
            if let Some(text) = self.attribute(element, name, at) {
                let Some(number) = numbers(&text).filter(|n| n.len() == 1) else {
                    self.problems.error(at, format!("`{name}` is `{text}`"), "write a number");
                    return None;
                };
                *value = number[0];
            }
        }
        Some(out)
    }

    pub(super) fn transform(&mut self, element: Element<'_, '_>, rows: &Lines) -> Transform {
        let mut whole = Transform { map: IDENTITY, look: None };
        for (index, child) in element.children().filter(Element::is_element).enumerate() {
            let at = rows.place(child);
            let Some(step) = self.step(child, &at) else { continue };
            whole.look = step.look.filter(|_| index == 0);
            whole.map = chained(&step.map, &whole.map);
        }
        whole
    }

    fn step(&mut self, element: Element<'_, '_>, at: &Place) -> Option<Transform> {
        let plain = |map| Some(Transform { map, look: None });
        self.check_attributes(element, at);
        match element.tag_name().name() {
            "translate" if element.has_attribute("value") => plain(translation(self.triple(element, "value", at)?)),
            "translate" => plain(translation(self.axes(element, 0.0, at)?)),
            "scale" => {
                let Some(text) = self.attribute(element, "value", at) else {
                    return plain(scaling(self.axes(element, 1.0, at)?));
                };
                match numbers(&text).as_deref() {
                    Some([all]) => plain(scaling([*all; 3])),
                    Some([x, y, z]) => plain(scaling([*x, *y, *z])),
                    _ => {
                        self.problems.error(at, format!("`{text}` is no scale"), "write one number or three");
                        None
                    }
                }
            }
            "rotate" => {
                let axis = match element.has_attribute("value") {
                    true => self.triple(element, "value", at)?,
                    false => self.axes(element, 0.0, at)?,
                };
                let text = self.needed(element, "angle", at)?;
                let angle = numbers(&text).filter(|n| n.len() == 1);
                let map = angle.and_then(|angle| rotate(axis, angle[0]));
                if map.is_none() {
                    self.problems.error(
                        at,
                        format!("a rotation by `{text}` about {axis:?}"),
                        "give an axis and degrees",
                    );
                }
                plain(map?)
            }
            "lookat" => {
                let origin = self.triple(element, "origin", at)?;
                let target = self.triple(element, "target", at)?;
                let forward = sub(target, origin);
                let up = match element.has_attribute("up") {
                    true => self.triple(element, "up", at)?,
                    false => any_up(unit(forward)),
                };
                let map = look(origin, target, up);
                if map.is_none() {
                    self.problems.error(at, "it looks nowhere", "give a target elsewhere, and `up` not along the view");
                }
                Some(Transform { map: map?, look: Some([origin, target, up]) })
            }
            "matrix" => {
                let text = self.needed(element, "value", at)?;
                let map = numbers(&text).and_then(|n| match n.len() {
                    9 => Some([[n[0], n[1], n[2], 0.0], [n[3], n[4], n[5], 0.0], [n[6], n[7], n[8], 0.0]]),
                    16 if n[12..] == [0.0, 0.0, 0.0, 1.0] => {
                        Some([0, 4, 8].map(|i| [n[i], n[i + 1], n[i + 2], n[i + 3]]))
                    }
                    _ => None,
                });
                if map.is_none() {
                    let remedy = "write 9 numbers, or 16 that end in 0 0 0 1";
                    self.problems.error(at, "a matrix that is not affine", remedy);
                }
                plain(map?)
            }
            other => {
                self.problems.error(at, format!("transforms `{other}` are not supported"), "write a `matrix`");
                None
            }
        }
    }
}
