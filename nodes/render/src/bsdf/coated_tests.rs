//! Rough plastic held against its model in f64, which is written down here once more: no code is shared.
//!
//! Source: Walter et al. 2007 for interfaces, Heitz 2018 for the normals seen; the plugin `roughplastic` of Mitsuba 3
//! for the tables of 64 cosines.

use super::*;
use glam::{DVec3, Vec2, Vec3};
use tauflow_data::rng::Stream;

const STEPS: usize = 64;

/// Alphas and indices of refraction.
const PLASTICS: [(f64, f64); 6] = [(0.05, 1.5), (0.1, 1.5), (0.15, 1.5), (0.2, 1.49), (0.3, 1.49), (0.6, 1.7)];

/// Reflectance, and the cosine of the refracted direction.
fn fresnel(cos: f64, eta: f64) -> (f64, f64) {
    let square = 1.0 - (1.0 - cos * cos) / (eta * eta);
    if square <= 0.0 {
        return (1.0, 0.0);
    }
    let t = square.sqrt();
    let (s, p) = ((cos - eta * t) / (cos + eta * t), (t - eta * cos) / (t + eta * cos));
    (0.5 * (s * s + p * p), t)
}

fn g1(alpha: f64, cos: f64) -> f64 {
    2.0 / (1.0 + (1.0 + alpha * alpha * (1.0 - cos * cos) / (cos * cos)).sqrt())
}

/// The normal that is seen from `v` at a point of the disk.
fn normal(alpha: f64, v: DVec3, [x, y]: [f64; 2]) -> DVec3 {
    let h = DVec3::new(alpha * v.x, alpha * v.y, v.z).normalize();
    let t1 = if h.x.hypot(h.y) > 0.0 { DVec3::new(-h.y, h.x, 0.0).normalize() } else { DVec3::X };
    let t2 = h.cross(t1);
    let s = 0.5 * (1.0 + h.z);
    let y = (1.0 - s) * (1.0 - x * x).max(0.0).sqrt() + s * y;
    let n = t1 * x + t2 * y + h * (1.0 - x * x - y * y).max(0.0).sqrt();
    DVec3::new(alpha * n.x, alpha * n.y, n.z.max(0.0)).normalize()
}

/// Mean of what is reflected or transmitted over the normals that are seen at a cosine: weighted points of the disk.
fn mean(alpha: f64, eta: f64, cos: f64, points: &[([f64; 2], f64)], reflected: bool) -> f64 {
    let v = DVec3::new((1.0 - cos * cos).max(0.0).sqrt(), 0.0, cos);
    let (mut sum, mut all) = (0.0, 0.0);
    for (point, weight) in points {
        let m = normal(alpha, v, *point);
        let d = v.dot(m);
        let (f, t) = fresnel(d, eta);
        let value = if reflected {
            let z = 2.0 * d * m.z - v.z;
            if z > 0.0 { f * g1(alpha, z) } else { 0.0 }
        } else {
            let z = v.z / eta - m.z * (d / eta - t);
            if t > 0.0 && z > 0.0 { (1.0 - f) * g1(alpha, z) } else { 0.0 }
        };
        sum += weight * value;
        all += weight;
    }
    sum / all
}

/// Many points of half of the disk, of which no two angles have the same radii: even radii would all miss the cusp of
/// total reflection alike.
fn fine(radii: usize, angles: usize) -> Vec<([f64; 2], f64)> {
    const GOLDEN: f64 = 0.618_033_988_749_894_9;
    let ring = |i: usize, j: usize| ((i as f64 + (GOLDEN * (j as f64 + 0.5)).fract()) / radii as f64).sqrt();
    let turn = |j: usize| std::f64::consts::PI * ((j as f64 + 0.5) / angles as f64 - 0.5);
    let at = |i: usize, j: usize| [ring(i, j) * libm::cos(turn(j)), ring(i, j) * libm::sin(turn(j))];
    (0..radii * angles).map(|k| (at(k / angles, k % angles), 1.0)).collect()
}

/// Mitsuba's points: `count` Gauss-Legendre nodes along each side of a square, which is mapped to the disk.
fn square(count: usize) -> Vec<([f64; 2], f64)> {
    let nodes: Vec<(f64, f64)> = (0..count)
        .map(|i| {
            let mut x = libm::cos(std::f64::consts::PI * (i as f64 + 0.75) / (count as f64 + 0.5));
            let mut slope = 1.0;
            for _ in 0..20 {
                let (mut p, mut before) = (x, 1.0);
                for k in 2..=count {
                    let k = k as f64;
                    (p, before) = (((2.0 * k - 1.0) * x * p - (k - 1.0) * before) / k, p);
                }
                slope = count as f64 * (x * p - before) / (x * x - 1.0);
                x -= p / slope;
            }
            (x, 2.0 / ((1.0 - x * x) * slope * slope))
        })
        .collect();
    let mapped = |x: f64, y: f64| {
        let quarter = std::f64::consts::FRAC_PI_4;
        let (r, turn) = if x.abs() >= y.abs() { (x, quarter * y / x) } else { (y, 2.0 * quarter - quarter * x / y) };
        [r * libm::cos(turn), r * libm::sin(turn)]
    };
    nodes.iter().flat_map(|(x, a)| nodes.iter().map(move |(y, b)| (mapped(*x, *y), a * b))).collect()
}

fn cosine(i: usize) -> f64 {
    (i as f64 / (STEPS - 1) as f64).max(1e-4)
}

/// Light that the coat throws back inside, by the plugin's sum over its cosines.
fn inner(alpha: f64, eta: f64, points: &[([f64; 2], f64)]) -> f64 {
    let sum: f64 = (0..STEPS).map(|i| cosine(i) * mean(alpha, 1.0 / eta, cosine(i), points, true)).sum();
    2.0 * sum / STEPS as f64
}

#[test]
fn rough_plastic_throws_back_inside_what_its_model_says() {
    let (fine, mitsuba) = (fine(1024, 64), square(128));
    println!("alpha  eta   inner     our diffuse light  Mitsuba's");
    for (alpha, eta) in PLASTICS {
        let exact = inner(alpha, eta, &fine);
        // The base goes with 1 / (1 - inner).
        let brighter = |inner: f64| (1.0 - exact) / (1.0 - inner) - 1.0;
        let ours = brighter(f64::from(Coat::new(eta as f32, alpha as f32).inner));
        let theirs = brighter(inner(alpha, eta, &mitsuba));
        println!("{alpha:<5}  {eta:<4}  {exact:.6}  {:+.4}%  {:+.4}%", 100.0 * ours, 100.0 * theirs);
        // Even radii err by 2.5e-3 at the first of these, and by 1.2e-3 at the second.
        assert!(ours.abs() < 1.5e-4, "{alpha} {eta}: {ours}");
        assert!(theirs.abs() < 3e-4, "{alpha} {eta}: {theirs}");
    }
}

#[test]
fn rough_plastic_lets_in_what_its_model_says() {
    let fine = fine(512, 64);
    for (alpha, eta) in PLASTICS {
        let coat = Coat::new(eta as f32, alpha as f32);
        for i in (3..STEPS).step_by(12) {
            let exact = mean(alpha, eta, cosine(i), &fine, false);
            let found = f64::from(coat.enters(cosine(i) as f32));
            assert!((found / exact - 1.0).abs() < 6e-4, "{alpha} {eta} {i}: {found} {exact}");
        }
    }
}

#[test]
fn rough_plastic_reflects_what_its_model_says_by_quadrature_and_by_draws() {
    const ROWS: usize = 512;
    const COLUMNS: usize = 256;
    const DRAWS: u32 = 400_000;
    let fine = fine(512, 64);
    for (alpha, eta, cos) in [(0.15, 1.5, 0.8), (0.3, 1.49, 0.95), (0.6, 1.7, 0.4)] {
        let coat = Coat::new(eta as f32, alpha as f32);
        let plastic = Plastic { base: Triple::new(0.5f32, 0.5, 0.5), coat: &coat };
        let wo: Triple<f32> = Vec3::new((1.0f64 - cos * cos).sqrt() as f32, 0.0, cos as f32).into();
        // Closed: what the coat reflects, and the base between its tables: in f64, and as the coat has them.
        let base = |table: &dyn Fn(f64) -> f64, inner: f64| {
            let cell = |i: u32| (f64::from(i) + 0.5) / 20_000.0;
            let leaves: f64 = (0..20_000).map(|i| 2.0 * cell(i) * table(cell(i)) / 20_000.0).sum();
            0.5 * table(cos) * leaves / (eta * eta * (1.0 - inner))
        };
        let table: Vec<f64> = (0..STEPS).map(|i| mean(alpha, eta, cosine(i), &fine, false)).collect();
        let exact = |cos: f64| {
            let at = cos * (STEPS - 1) as f64;
            let i = (at as usize).min(STEPS - 2);
            table[i] + (table[i + 1] - table[i]) * (at - i as f64)
        };
        let reflected = mean(alpha, eta, cos, &fine, true);
        let closed = reflected + base(&exact, inner(alpha, eta, &fine));
        let own = reflected + base(&|cos| f64::from(coat.enters(cos as f32)), f64::from(coat.inner));
        // Quadrature of the values, over cosine and azimuth.
        let mut values = 0.0;
        for row in 0..ROWS {
            let z = (row as f64 + 0.5) / ROWS as f64;
            for column in 0..COLUMNS {
                let turn = std::f64::consts::TAU * (column as f64 + 0.5) / COLUMNS as f64;
                let r = (1.0 - z * z).sqrt();
                let wi = Vec3::new((r * libm::cos(turn)) as f32, (r * libm::sin(turn)) as f32, z as f32);
                values += f64::from(plastic.eval(wo, wi.into()).0.x);
            }
        }
        values *= std::f64::consts::TAU / (ROWS * COLUMNS) as f64;
        // Draws.
        let mut stream = Stream::new(5, &[]).part("rough plastic");
        let (mut sum, mut squares) = (0.0, 0.0);
        for _ in 0..DRAWS {
            let [lobe, x, y] = [0; 3].map(|_| stream.uniform() as f32);
            let drawn = plastic.sample(wo, lobe, Vec2::new(x, y).into());
            let weight = if drawn.valid { f64::from(drawn.weight.x) } else { 0.0 };
            sum += weight;
            squares += weight * weight;
        }
        let n = f64::from(DRAWS);
        let drawn = sum / n;
        let error = ((squares / n - drawn * drawn) / n).sqrt();
        println!(
            "{alpha} {eta} {cos}: f64 {closed:.6}, of our tables {own:.6}, quadrature {values:.6}, draws {drawn:.6}"
        );
        assert!((values / own - 1.0).abs() < 1e-4, "{alpha}: {values} {own}");
        assert!((drawn - values).abs() < 4.0 * error + 1e-4 * values, "{alpha}: {drawn} +- {error}, {values}");
        assert!((own / closed - 1.0).abs() < 1e-3, "{alpha}: {own} {closed}");
    }
}

#[test]
fn tables_of_coats_are_the_same_by_all_instructions() {
    let cosines: [f32; STEPS] = std::array::from_fn(|i| cosine(i) as f32);
    for (disk, through) in [(ggx::half_disk(), true), (ggx::staggered_half_disk(), false)] {
        let interface =
            Interface { alpha: 0.3, beckmann: false, eta: if through { 1.5 } else { 1.0 / 1.5 }, disk: &disk, through };
        let shares = |instructions| {
            let mut shares = vec![0.0; STEPS];
            kernels(instructions).shares(&interface, &cosines, &mut shares);
            shares.iter().map(|s| s.to_bits()).collect::<Vec<_>>()
        };
        let portable = shares(Instructions::Portable);
        assert!(portable.iter().any(|bits| *bits != portable[0]));
        tauflow_testing::skip_missing_instructions(Instructions::available().into_iter().map(Instructions::name));
        for instructions in Instructions::available() {
            assert_eq!(shares(instructions), portable, "{instructions:?} {through}");
        }
    }
}
