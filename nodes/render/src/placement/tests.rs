use super::*;
use tauflow_data::{rng::Stream, scene::Affine};

/// A map that turns, stretches and moves; mirrored every other time.
pub(crate) fn draw(stream: &mut Stream, size: f64, away: f64) -> Affine {
    loop {
        let mut affine: Affine = std::array::from_fn(|_| std::array::from_fn(|_| stream.range(-1.0, 1.0)));
        for row in &mut affine {
            row[..3].iter_mut().for_each(|v| *v *= size);
            row[3] *= away;
        }
        let map = Map::new(&affine);
        let [x, y, z] = map.columns();
        if x.cross(y).dot(z).abs() > 0.1 * size.powi(3) {
            return affine;
        }
    }
}

#[test]
fn bounds_cover_points_and_the_way_back() {
    let mut stream = Stream::new(3, &[]);
    for round in 0..2000 {
        let size = [1.0, 1e-3, 1e3, 0.02][round % 4];
        let away = [1.0, 100.0, 1e4, 0.0][round / 4 % 4];
        let Some(placement) = Placement::new(&Map::new(&draw(&mut stream, size, away))) else { continue };
        let mut placements = Placements::default();
        placements.push(&placement);
        let placed = placements.placed::<f32>(0);
        let mut at = || stream.range(-1.0, 1.0) as f32;
        let local = Vec3::new(at(), at(), at());
        let known = local.abs() * gamma(7);
        // A point that is off by as much as is said.
        let exact = local.as_dvec3() + DVec3::new(at().into(), at().into(), at().into()) * known.as_dvec3();
        let surface = placement.linear * exact + placement.shift;
        let (p, error) = placed.point(local.into(), known.into());
        let (p, error) = (Vec3::from(p).as_dvec3(), Vec3::from(error).as_dvec3());
        assert!((p - surface).abs().cmple(error).all(), "{p} {surface} {error}");
        // A ray that begins there begins within the bound when it is brought back.
        let ray = Rays { origin: p.as_vec3().to_array().map(|v| [v]), direction: [[1.0], [0.0], [0.0]] };
        let own = placements.enter(0, placement.unit(), &ray).origin;
        let back = placement.point(Vec3::new(own[0][0], own[1][0], own[2][0]));
        assert!((back - surface).abs().cmple(error).all(), "{back} {surface} {error}");
        assert!(error.max_element() < 1e-5 * (size + away), "{error} of {size} at {away}");
        // Normals are orthogonal to what lies in the surface.
        let (a, b) = (Vec3::new(at(), at(), at()), Vec3::new(at(), at(), at()));
        let n = a.cross(b).normalize();
        let world = Vec3::from(placed.normal(n.into()));
        let along = Vec3::from(placed.vector(a.into())).normalize();
        assert!(world.dot(along).abs() < 1e-4 && (world.length() - 1.0).abs() < 1e-6, "{world} {along}");
    }
}

#[test]
fn only_benign_placements_share() {
    let diagonal =
        |x: f64, y: f64, z: f64, s: f64| -> Affine { [[x, 0.0, 0.0, s], [0.0, y, 0.0, -s], [0.0, 0.0, z, s]] };
    let shares = |affine: Affine| Placement::new(&Map::new(&affine)).is_some();
    for benign in [1.0, -1.0, 1e-5, 1e5] {
        assert!(shares(diagonal(benign, benign, benign, 3.0)) && shares(diagonal(1.0, 2.0, 5.0, 1e4 * benign)));
    }
    let hostile = [
        diagonal(0.0, 1.0, 1.0, 0.0),
        diagonal(0.0, 0.0, 0.0, 0.0),
        diagonal(1e-30, 1e-30, 1e-30, 0.0),
        diagonal(1e30, 1e30, 1e30, 0.0),
        diagonal(1e-9, 1.0, 1.0, 0.0),
        diagonal(1.0, 1.0, 1e4, 0.0),
        diagonal(f64::NAN, 1.0, 1.0, 0.0),
        diagonal(1.0, f64::INFINITY, 1.0, 0.0),
        diagonal(1.0, 1.0, 1.0, f64::NAN),
        diagonal(1.0, 1.0, 1.0, 1e300),
        [[1.0, 1.0, 0.0, 0.0], [1.0, 1.0 + 1e-12, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0]],
    ];
    for affine in hostile {
        assert!(!shares(affine), "{affine:?}");
    }
}

#[test]
fn sharing_is_for_what_saves_enough() {
    let worth = Sharing::Worthwhile;
    assert!(worth.shares(2, WORTH) && !worth.shares(2, WORTH - 1) && !worth.shares(1, 10 * WORTH));
    assert!(!worth.shares(1 << 20, LEAST - 1) && worth.shares(1 << 20, LEAST));
    assert!(Sharing::Always.shares(2, 1) && !Sharing::Always.shares(1, 5) && !Sharing::Never.shares(9, WORTH));
}
