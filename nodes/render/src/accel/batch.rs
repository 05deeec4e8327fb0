//! Many rays for those who have them apart from a render: benchmarks, and whoever looks at a scene.

use super::{Accel, Hit, SPARE, Set, Sweep};
use crate::{dispatch::kernels, geometry::Ray};
use tauflow_instructions::Instructions;

/// Rays side by side, and what they have met.
pub struct RayBatch {
    rows: [Vec<f32>; 6],
    ends: Vec<f32>,
    t: Vec<f32>,
    u: Vec<f32>,
    v: Vec<f32>,
    primitive: Vec<u32>,
    sweep: Sweep,
}

impl RayBatch {
    /// Takes rays; some thousand are a good number.
    pub fn new(rays: &[Ray]) -> Self {
        let room = rays.len() + SPARE;
        let row = |value: &dyn Fn(&Ray) -> f32| rays.iter().map(value).chain([0.0; SPARE]).collect::<Vec<f32>>();
        let rows = std::array::from_fn(|k| {
            if k < 3 { row(&|ray: &Ray| ray.origin[k]) } else { row(&|ray: &Ray| ray.direction[k - 3]) }
        });
        Self {
            rows,
            ends: row(&|ray: &Ray| ray.t_max),
            t: vec![0.0; room],
            u: vec![0.0; room],
            v: vec![0.0; room],
            primitive: vec![u32::MAX; room],
            sweep: Sweep::default(),
        }
    }

    /// Number of rays.
    pub fn len(&self) -> usize {
        self.ends.len() - SPARE
    }

    /// Whether there are none.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Finds the nearest hits.
    pub fn nearest(&mut self, accel: &Accel, instructions: Instructions) {
        self.meet(accel, instructions, false);
    }

    /// Finds out which rays meet anything before they end.
    pub fn stopped(&mut self, accel: &Accel, instructions: Instructions) {
        self.meet(accel, instructions, true);
    }

    fn meet(&mut self, accel: &Accel, instructions: Instructions, any: bool) {
        let count = self.len();
        self.t.copy_from_slice(&self.ends);
        self.primitive.fill(u32::MAX);
        let [ox, oy, oz, dx, dy, dz] = &self.rows;
        let mut set = Set {
            origin: [ox, oy, oz],
            direction: [dx, dy, dz],
            t: &mut self.t,
            u: &mut self.u,
            v: &mut self.v,
            primitive: &mut self.primitive,
        };
        let kernels = kernels(instructions);
        if any {
            kernels.stopped(accel, &mut set, count, &mut self.sweep);
        } else {
            kernels.nearest(accel, &mut set, count, &mut self.sweep);
        }
    }

    /// The nearest hit of a ray, after [`RayBatch::nearest`].
    pub fn hit(&self, ray: usize) -> Option<Hit> {
        let primitive = self.primitive[ray];
        (primitive != u32::MAX).then(|| Hit { t: self.t[ray], u: self.u[ray], v: self.v[ray], primitive })
    }

    /// Whether a ray was stopped, after [`RayBatch::stopped`].
    pub fn is_stopped(&self, ray: usize) -> bool {
        self.t[ray] < 0.0
    }
}
