//! Sets of texture coordinates. A mesh of ours has one; others are read where they are an affine map of it, as copies
//! and atlases often are. Knows nothing of textures.

/// A set of texture coordinates as an affine map of the one that a mesh keeps.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct UvSet {
    /// Its number.
    pub set: u32,
    /// Rows of the 2x3 matrix, as bits, so that they can be compared; none for the set that is kept.
    map: Option<[[u64; 3]; 2]>,
}

/// Largest distance from the map, in the unit of texture coordinates: a tenth of a texel of 1024.
const NEAR: f64 = 1e-4;

impl UvSet {
    /// The set that a mesh keeps.
    pub fn kept(set: u32) -> Self {
        Self { set, map: None }
    }

    /// Set `set`, if it is an affine map of the one that is kept.
    pub fn mapped(set: u32, kept: &[[f32; 2]], other: &[[f32; 2]]) -> Option<Self> {
        let map = affine(kept, other)?;
        Some(Self { set, map: Some(map.map(|row| row.map(f64::to_bits))) })
    }

    /// A map of this set's coordinates as one of those that are kept.
    pub fn after(&self, uv: &[[f64; 3]; 2]) -> [[f64; 3]; 2] {
        let Some(map) = self.map else { return *uv };
        let own = map.map(|row| row.map(f64::from_bits));
        let cell =
            |row: &[f64; 3], c: usize| row[0] * own[0][c] + row[1] * own[1][c] + if c == 2 { row[2] } else { 0.0 };
        uv.map(|row| [0, 1, 2].map(|c| cell(&row, c)))
    }
}

/// The affine map of least squares, if all points lie by it.
fn affine(from: &[[f32; 2]], to: &[[f32; 2]]) -> Option<[[f64; 3]; 2]> {
    let wide = |p: &[f32; 2]| p.map(f64::from);
    if from.is_empty() || from.len() != to.len() {
        return None;
    }
    let n = from.len() as f64;
    let mean =
        |points: &[[f32; 2]]| points.iter().map(wide).fold([0.0; 2], |sum, p| [sum[0] + p[0] / n, sum[1] + p[1] / n]);
    let (a, b) = (mean(from), mean(to));
    let (mut xx, mut xy, mut yy, mut right) = (0.0, 0.0, 0.0, [[0.0; 2]; 2]);
    for (p, q) in from.iter().map(wide).zip(to.iter().map(wide)) {
        let (x, y) = (p[0] - a[0], p[1] - a[1]);
        (xx, xy, yy) = (xx + x * x, xy + x * y, yy + y * y);
        for (sums, d) in right.iter_mut().zip([q[0] - b[0], q[1] - b[1]]) {
            *sums = [sums[0] + x * d, sums[1] + y * d];
        }
    }
    let det = xx * yy - xy * xy;
    let rows = right.map(|[x, y]| {
        if det > 1e-12 * (xx + yy) * (xx + yy) {
            [(yy * x - xy * y) / det, (xx * y - xy * x) / det]
        } else if xx + yy > 0.0 {
            // All on a line: along it.
            let k = (x * xx + y * xy, x * xy + y * yy);
            let whole = (xx + yy) * (xx + yy);
            [k.0 / whole, k.1 / whole]
        } else {
            [0.0; 2]
        }
    });
    let map = [0, 1].map(|r| {
        let [x, y] = rows[r];
        [x, y, b[r] - x * a[0] - y * a[1]]
    });
    let fits = from
        .iter()
        .map(wide)
        .zip(to.iter().map(wide))
        .all(|(p, q)| (0..2).all(|r| (map[r][0] * p[0] + map[r][1] * p[1] + map[r][2] - q[r]).abs() <= NEAR));
    fits.then_some(map)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sets_that_are_turned_moved_or_scaled_are_found_and_others_are_not() {
        let kept = [[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0], [0.25, 0.75]];
        let atlas = kept.map(|[u, v]: [f32; 2]| [0.5 - 0.25 * v, 0.25 + 0.5 * u]);
        let found = UvSet::mapped(1, &kept, &atlas).expect("a quarter turn");
        let same = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0]];
        let map = found.after(&same);
        let expected = [[0.0, -0.25, 0.5], [0.5, 0.0, 0.25]];
        let near = |a: &[[f64; 3]; 2], b: [[f64; 3]; 2]| {
            a.iter().flatten().zip(b.iter().flatten()).all(|(a, b)| (a - b).abs() < 1e-12)
        };
        assert!(near(&map, expected), "{map:?}");
        // A transform of the texture comes after it: here half the size, moved by a tenth.
        let map = found.after(&[[0.5, 0.0, 0.1], [0.0, 0.5, 0.0]]);
        assert!(near(&map, [[0.0, -0.125, 0.35], [0.25, 0.0, 0.125]]), "{map:?}");
        let mut other = atlas;
        other[4][0] += 0.001;
        assert_eq!(UvSet::mapped(1, &kept, &other), None);
        assert_eq!(UvSet::kept(3).after(&same), same);
    }

    #[test]
    fn coordinates_in_one_place_or_on_a_line_have_a_map_too() {
        let point = [[0.5, 0.25]; 3];
        let map =
            UvSet::mapped(1, &point, &[[0.75, 0.125]; 3]).expect("constant").after(&[[1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]);
        assert_eq!(map, [[0.0, 0.0, 0.75], [0.0, 0.0, 0.125]]);
        assert_eq!(UvSet::mapped(1, &point, &[[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]]), None);
        let line = [[0.0, 0.0], [0.5, 0.5], [1.0, 1.0]];
        let along = [[0.25, 1.0], [0.5, 0.5], [0.75, 0.0]];
        let found = UvSet::mapped(1, &line, &along).expect("along it").after(&[[1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]);
        let [u, v] = found.map(|row| row[0] * 0.5 + row[1] * 0.5 + row[2]);
        assert!((u - 0.5).abs() < 1e-12 && (v - 0.5).abs() < 1e-12, "{found:?}");
        assert_eq!(UvSet::mapped(1, &[[f32::NAN; 2]; 3], &along), None);
    }
}
