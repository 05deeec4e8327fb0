//! Shapes: closed, outward, of the right size.

use super::*;
use tauflow_data::{
    geom::{dot, length, sub},
    mesh_check::{is_closed, signed_volume},
};

fn closed(body: &Body, volume: f64, share: f64) {
    let mesh = body.mesh([0.0; 3]);
    assert!(is_closed(&mesh));
    let found = signed_volume(&mesh);
    assert!((found - volume).abs() < share * volume, "volume {found}, expected about {volume}");
}

#[test]
fn blocks_have_their_volume() {
    closed(&block([1.0, 2.0, 3.0], [0.5, 0.25, 1.0]), 1.0, 1e-6);
    closed(&panel([0.0; 3], [0.5, 0.25, 1.0]), 1.0, 1e-6);
    closed(&board([0.0; 3], [0.5, 0.01, 0.2]), 0.008, 0.01);
    let ball_like = soft_block([0.0; 3], [1.0; 3], 0.98, 8);
    closed(&ball_like, 4.0 / 3.0 * PI, 0.08);
    let reach = ball_like.points.iter().flatten().fold(0.0f64, |m, v| m.max(v.abs()));
    assert!((reach - 1.0).abs() < 1e-9);
}

#[test]
fn grain_runs_along_the_long_side() {
    let post = block([0.0; 3], [0.05, 1.0, 0.05]).mesh([0.0; 3]);
    let uvs = post.uvs.as_ref().expect("always there");
    for t in &post.triangles {
        for (a, b) in [(t[0], t[1]), (t[1], t[2]), (t[2], t[0])] {
            let (p, q) = (post.positions[a as usize], post.positions[b as usize]);
            if (p[1] - q[1]).abs() > 1.0 && p[0] == q[0] && p[2] == q[2] {
                // 2 m along the post are 2 in u and nothing in v.
                assert!((uvs[a as usize][0] - uvs[b as usize][0]).abs() == 2.0);
                assert!(uvs[a as usize][1] == uvs[b as usize][1]);
            }
        }
    }
}

#[test]
fn round_things_have_their_volume() {
    closed(&ball(1.0, 64), 4.0 / 3.0 * PI, 0.01);
    closed(&icosphere(4, |_| 1.0), 4.0 / 3.0 * PI, 0.01);
    closed(&lathe(&[[0.0, 0.0], [1.0, 0.0], [1.0, 2.0], [0.0, 2.0]], 96), TAU, 0.01);
    closed(
        &lathe_loop(&circle(32, 0.25).iter().map(|p| [p[0] + 1.0, p[1]]).collect::<Vec<_>>(), 64),
        TAU * PI / 16.0,
        0.02,
    );
    closed(&tube_loop(&ring_path(1.0, 0.0, 64), 32, 0.25), TAU * PI / 16.0, 0.02);
}

#[test]
fn sweeps_and_slabs_are_closed_and_face_outwards() {
    closed(&rod([0.0; 3], [1.0, 2.0, 2.0], 0.1, 48), 3.0 * PI * 0.01, 0.01);
    closed(&beam([0.0; 3], [3.0, 0.0, 0.0], [0.2, 0.5], [0.0, 1.0, 0.0]), 0.3, 1e-6);
    let path = fillet(&[[0.0; 3], [0.0, 1.0, 0.0], [1.0, 1.0, 0.0], [1.0, 1.0, 1.0]], 0.2, 8);
    let long: f64 = path.windows(2).map(|p| length(sub(p[1], p[0]))).sum();
    closed(&tube(&path, 24, |_| 0.05), long * PI * 0.0025, 0.03);
    closed(&slab(4, 6, 0.1, |s, t| [2.0 * s, 0.3, -3.0 * t]), 0.6, 1e-6);
    let up = sheet(2, 2, |s, t| [s, 0.0, -t]).mesh([0.0; 3]);
    assert!(up.normals.expect("always there").iter().all(|n| n[1] > 0.99));
}

#[test]
fn extrusions_keep_their_holes() {
    let square = [[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]];
    let hole = |x: f64, y: f64| square.iter().map(|p| [x + 0.2 * p[0], y + 0.2 * p[1]]).collect::<Vec<_>>();
    let holes = [hole(-0.5, -0.5), hole(0.5, -0.5), hole(0.5, 0.5), hole(-0.5, 0.5), hole(0.0, 0.0)];
    closed(&extrude_with_holes(&square, &holes, 0.5), 0.5 * (4.0 - 5.0 * 0.16), 1e-6);
    // An outline that is not seen whole from anywhere.
    let comb = [
        [0.0, 0.0],
        [5.0, 0.0],
        [5.0, 3.0],
        [4.0, 3.0],
        [4.0, 1.0],
        [3.0, 1.0],
        [3.0, 3.0],
        [2.0, 3.0],
        [2.0, 1.0],
        [1.0, 1.0],
        [1.0, 3.0],
        [0.0, 3.0],
    ];
    closed(&extrude(&comb, 1.0), 11.0, 1e-6);
}

#[test]
fn fields_are_closed_and_keep_sharp_edges() {
    let half = 0.5;
    let cube = Field {
        distance: |p: [f64; 3]| p.iter().fold(f64::NEG_INFINITY, |m, v| m.max(v.abs() - half)),
        low: [-0.61; 3],
        high: [0.61; 3],
    }
    .body(0.07);
    closed(&cube, 1.0, 0.01);
    let corner = cube.points.iter().map(|p| length(sub(*p, [half; 3]))).fold(f64::INFINITY, f64::min);
    assert!(corner < 0.01, "the corner is cut by {corner}");
    // A drilled ball, cut by the box's side as well: still closed.
    let drilled = Field {
        distance: |p: [f64; 3]| (length(p) - 1.0).max(0.4 - (p[0] * p[0] + p[2] * p[2]).sqrt()),
        low: [-0.8, -1.1, -1.1],
        high: [1.1; 3],
    }
    .body(0.08);
    assert!(is_closed(&drilled.mesh([0.0; 3])));
    assert!(signed_volume(&drilled.mesh([0.0; 3])) > 2.0);
}

#[test]
fn facets_meet() {
    let cube: Vec<[f64; 3]> =
        (0..3).flat_map(|i| [-1.0, 1.0].map(|s| core::array::from_fn(|k| if k == i { s } else { 0.0 }))).collect();
    closed(&faceted(&cube), 8.0, 1e-6);
}

#[test]
fn smooth_stays_smooth_and_sharp_stays_sharp() {
    let round = ball(1.0, 32).mesh([0.0; 3]);
    for (p, n) in round.positions.iter().zip(round.normals.expect("always there")) {
        assert!(dot(p.map(f64::from), n.map(f64::from)) > 0.995);
    }
    let sharp = block([0.0; 3], [1.0; 3]).mesh([0.0; 3]);
    assert!(sharp.normals.expect("always there").iter().all(|n| n.iter().filter(|v| v.abs() == 1.0).count() == 1));
}

#[test]
fn cloth_stays_out_of_the_floor_and_keeps_its_size() {
    let cloth = Cloth::new(12, 12, 0.02, |s, t| [s - 0.5, 0.4, 0.5 - t])
        .pinned(|s, t| (s - 0.5).abs() < 0.2 && (t - 0.5).abs() < 0.2)
        .fallen(60, |p| [p[0], p[1].max(0.0), p[2]]);
    let body = cloth.sheet();
    let low = body.points.iter().map(|p| p[1]).fold(f64::INFINITY, f64::min);
    assert!((0.0..0.25).contains(&low), "{low}");
    let area: f64 = body
        .triangles
        .iter()
        .map(|t| {
            let [a, b, c] = t.map(|i| body.points[i as usize]);
            0.5 * length(tauflow_data::geom::cross(sub(b, a), sub(c, a)))
        })
        .sum();
    assert!((area - 1.0).abs() < 0.12, "{area}");
}

#[test]
fn text_is_as_wide_as_said() {
    let body = lettering("HI", 0.6, 0.1, 0.02);
    let (low, high) = body.points.iter().fold((0.0f64, 0.0f64), |(a, b), p| (a.min(p[0]), b.max(p[0])));
    // The last glyph stands in the middle of its cell: half a cell less to the right.
    assert!((-low - 0.5 * text_width("HI", 0.6)).abs() < 0.04 && high > 0.1);
    assert!(is_closed(&body.mesh([0.0; 3])));
}
