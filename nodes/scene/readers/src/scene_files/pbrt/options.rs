//! What a file says before its world: film, integrator and camera.

use super::{Directive, PbrtReader, Values};
use crate::scene_files::{
    build::{ENDLESS, camera, mirror, mirrors},
    mitsuba::Said,
};
use tauflow_data::{
    geom::{Vec3, cross, determinant, dot, sub, unit},
    maths,
    scene::Affine,
};

impl<'t> PbrtReader<'t, '_, '_> {
    pub(super) fn film(&mut self, directive: &'t Directive) {
        if !matches!(self.name(directive), "rgb" | "gbuffer" | "spectral") {
            self.unsupported(directive, "use `rgb`");
        }
        let mut side = |name: &str, default: f64| {
            let value = self.number(directive, name).unwrap_or(default);
            if !(1.0..=65536.0).contains(&value) {
                self.build.problems.error(&directive.at, format!("a film with {name} {value}"), "use 1 to 65536");
            }
            value.clamp(1.0, 65536.0) as u32
        };
        self.film = [side("xresolution", 1280.0), side("yresolution", 720.0)];
        let sensor = self.text(directive, "sensor").unwrap_or("cie1931");
        if sensor != "cie1931" {
            let what = format!("the sensor `{sensor}` is not supported");
            self.build.problems.error(&directive.at, what, "use `cie1931`, which is pbrt's default");
        }
        // Seconds, and speed of the film in ISO; 100 is 1.
        let seconds = self.number(directive, "exposuretime").unwrap_or(1.0);
        self.exposure[0] = seconds * self.number(directive, "iso").unwrap_or(100.0) / 100.0;
        self.pass_over(directive, &["filename", "savefp16", "diagonal", "coordinatesystem", "nbuckets"]);
        self.finish(directive);
    }

    pub(super) fn integrator(&mut self, directive: &'t Directive) {
        let sort = self.name(directive);
        match sort {
            "path" | "volpath" => {}
            "simplepath" | "simplevolpath" | "bdpt" | "mlt" | "lightpath" => {
                self.build.problems.note(&directive.at, format!("`{sort}` is rendered by the path tracer"));
            }
            _ => return self.unsupported(directive, "use `path`"),
        }
        // In pbrt, 0 bounces show emitters, which is a path of one segment here.
        let bounces = self.number(directive, "maxdepth").unwrap_or(5.0).max(0.0);
        self.max_depth = (bounces.min(f64::from(ENDLESS - 1)) as u32) + 1;
        if self.flag(directive, "regularize", false) {
            self.build.problems.error(&directive.at, "`regularize` is not supported", "set it to false");
        }
        let how = ["lightsampler", "sampledirect", "samplelights", "samplebsdf", "bootstrapsamples", "chains"];
        self.pass_over(directive, &how);
        self.pass_over(directive, &["mutationsperpixel", "largestepprobability", "sigma", "visualizestrategies"]);
        self.finish(directive);
    }

    pub(super) fn end(mut self) -> Said {
        let mut said = Said { camera: None, max_depth: self.max_depth, film: self.film, views: 1 };
        let Some((directive, world)) = self.camera else { return said };
        if self.name(directive) != "perspective" {
            self.unsupported(directive, "use `perspective`");
            return said;
        }
        let fov = self.number(directive, "fov").unwrap_or(90.0);
        let window = self.window(directive);
        if self.number(directive, "lensradius").unwrap_or(0.0) != 0.0 {
            let remedy = "set it to 0: nothing is out of focus";
            self.build.problems.error(&directive.at, "`lensradius` is not supported", remedy);
        }
        self.pass_over(directive, &["focaldistance", "shutteropen", "shutterclose"]);
        self.finish(directive);
        // The angle spans a window from -1 to 1.
        let half = maths::tan(fov.to_radians() * 0.5) * window;
        let fov_x = 2.0 * maths::atan(half).to_degrees();
        match Some(fov_x).filter(|wide| fov > 0.0 && fov < 180.0 && *wide > 0.0 && *wide < 180.0) {
            Some(fov) => {
                // A camera of pbrt stands where its scale has put it, and looks as if it had none.
                let mut camera = camera(&world, fov, 0.0);
                let forward = unit([0, 1, 2].map(|r: usize| world[r][2]));
                camera.target = [0, 1, 2].map(|i: usize| camera.origin[i] + forward[i]);
                camera.up = unit(camera.up);
                self.build.check_camera(&camera, &directive.at);
                if !mirrors(&world) {
                    let remedy =
                        "write `Scale -1 1 1` before its `LookAt`, which mirrors the picture, or take `normalmap` out";
                    mirror(self.build, &mut camera, &directive.at, remedy);
                }
                said.camera = Some(camera);
            }
            None => {
                let what = format!("a field of view of {fov} degrees");
                self.build.problems.error(&directive.at, what, "use an angle below 180");
            }
        }
        said
    }

    /// How far the window of a camera reaches to the side. It must be as wide and high as the film, around its middle.
    fn window(&mut self, directive: &'t Directive) -> f64 {
        let film = f64::from(self.film[0]) / f64::from(self.film[1]);
        let frame = self.number(directive, "frameaspectratio").unwrap_or(film);
        let [x, y] = if frame > 1.0 { [frame, 1.0] } else { [1.0, 1.0 / frame] };
        let mut window = [-x, x, -y, y];
        if let Some(param) = self.find(directive, "screenwindow") {
            match &param.values {
                Values::Numbers(values) if values.len() == 4 => window.copy_from_slice(values),
                _ => self.wrong(param, "list of 4 numbers"),
            }
        }
        let near = |a: f64, b: f64| (a - b).abs() <= 1e-6 * b.abs();
        let [left, right, low, high] = window;
        let sound = right > 0.0 && near(-left, right) && near(-low, high) && near(right / high, film);
        if !sound || !right.is_finite() {
            let what = "a window that is not around the middle, or not as wide and high as the film";
            self.build.problems.error(&directive.at, what, "leave `screenwindow` and `frameaspectratio` out");
            return 1.0;
        }
        right
    }
}

/// The inverse; none of a map that flattens space.
pub(super) fn inverse(m: &Affine) -> Option<Affine> {
    let det = determinant(m);
    if !(det.is_finite() && det != 0.0) {
        return None;
    }
    let row = |r: usize| [m[r][0], m[r][1], m[r][2]];
    let columns = [cross(row(1), row(2)), cross(row(2), row(0)), cross(row(0), row(1))];
    let linear = [0, 1, 2].map(|r: usize| [0, 1, 2].map(|c: usize| columns[c][r] / det));
    let shift = [m[0][3], m[1][3], m[2][3]];
    Some(linear.map(|row| [row[0], row[1], row[2], -dot(row, shift)]))
}

/// pbrt's `LookAt`: from the world into the space of a camera that looks along +z.
pub(super) fn look(n: [f64; 9]) -> Option<Affine> {
    let (from, to, up) = ([n[0], n[1], n[2]], [n[3], n[4], n[5]], [n[6], n[7], n[8]]);
    let forward = sub(to, from);
    let right = cross(unit(up), unit(forward));
    if !(dot(forward, forward) > 0.0 && dot(up, up) > 0.0 && dot(right, right) > 0.0) {
        return None;
    }
    let (forward, right): (Vec3, Vec3) = (unit(forward), unit(right));
    let up = cross(forward, right);
    inverse(&[0, 1, 2].map(|r: usize| [right[r], up[r], forward[r], from[r]]))
}

#[cfg(test)]
mod tests {
    use super::*;
    use tauflow_data::{
        geom::{compose, scaling, translation},
        scene::IDENTITY,
    };

    #[test]
    fn inverses_undo() {
        let map = compose(&translation([1.0, 2.0, 3.0]), &scaling([2.0, -4.0, 0.5]));
        let both = compose(&map, &inverse(&map).expect("it has one"));
        assert!(both.iter().flatten().zip(IDENTITY.iter().flatten()).all(|(a, b)| (a - b).abs() < 1e-12), "{both:?}");
        assert_eq!(inverse(&scaling([1.0, 0.0, 1.0])), None);
        let seen = look([0.0, 0.0, 5.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0]).expect("a view");
        assert_eq!(tauflow_data::geom::apply(&seen, [0.0, 0.0, 1.0]), [0.0, 0.0, 4.0]);
    }
}
