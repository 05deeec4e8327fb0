//! Heights of a piece of land. Knows nothing of what stands on it.

/// Heights over a square, on a grid, as the two triangles of each cell have them.
#[derive(Debug)]
pub struct Relief {
    /// Cells along a side.
    pub cells: usize,
    /// Half its side.
    pub half: f64,
    /// Heights at the corners, `(cells + 1)^2`, x fastest.
    pub heights: Vec<f64>,
}

impl Relief {
    /// The height at a place; none outside.
    pub fn height(&self, x: f64, z: f64) -> Option<f64> {
        let n = self.cells as f64;
        let (u, v) = ((x / self.half + 1.0) * 0.5 * n, (z / self.half + 1.0) * 0.5 * n);
        if !(u >= 0.0 && v >= 0.0 && u <= n && v <= n) {
            return None;
        }
        let (i, j) = ((u as usize).min(self.cells - 1), (v as usize).min(self.cells - 1));
        let (u, v) = (u - i as f64, v - j as f64);
        let at = |i: usize, j: usize| self.heights[j * (self.cells + 1) + i];
        let (a, b, c, d) = (at(i, j), at(i + 1, j), at(i, j + 1), at(i + 1, j + 1));
        // Cells are cut from (0, 0) to (1, 1).
        Some(if u > v { a + (b - a) * u + (d - b) * v } else { a + (c - a) * v + (d - c) * u })
    }
}
