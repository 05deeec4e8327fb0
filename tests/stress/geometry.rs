//! Surfaces in one place, slivers, heaps and broken meshes; cameras at the ends of what they can be.

use super::{
    about, held,
    rendering::{Add, difference, glowing, mean, rendered, within, world},
    scenes::{Built, ball, columns, floor_point},
};
use tauflow_data::{
    mesh::Mesh,
    scene::{IDENTITY, Texture},
};

/// A plate of strips of 2 m by 2e-6 m, two triangles each, of which every `of`th is there; they shine, and nothing else
/// does.
fn slivers(distance: f64, of: usize) -> Built {
    // The view is 1.4 mm wide.
    let mut built = Built::new([0.0, 0.0, distance], [0.0; 3], 0.08 / distance, 1);
    let black = built.diffuse([0.0; 3]);
    let (rows, width) = (2000, 2e-6);
    let mut mesh = Mesh::default();
    for row in (0..rows).step_by(of) {
        let edge = |row: usize| width * (row as f32 - rows as f32 / 2.0);
        let first = mesh.positions.len() as u32;
        let (low, high) = (edge(row), edge(row + 1));
        mesh.positions.extend([[-1.0, low, 0.0], [1.0, low, 0.0], [1.0, high, 0.0], [-1.0, high, 0.0]]);
        mesh.triangles.extend([[first, first + 1, first + 2], [first, first + 2, first + 3]]);
    }
    built.mesh(&mesh, IDENTITY, black).emission = Some(Texture::scalar(1.0));
    built
}

pub fn hazards(add: Add<'_>) {
    surfaces(add);
    cameras(add);
}

fn surfaces(add: Add<'_>) {
    let mut one = floor_point();
    one.sky([1.0; 3]);
    let mut two = one.clone();
    let again = two.scene.shapes[0].clone();
    two.scene.shapes.push(again);
    let came = rendered(&one, 8, 8, 16).and_then(|one| {
        let off = difference(&rendered(&two, 8, 8, 16)?, &one);
        held(off < 1e-6, format!("largest difference {}", about(off)))
    });
    add("two coincident copies of a floor".into(), "the image of one copy", came);
    // Two materials in one place: of several hits at one distance the first shape counts, for every ray.
    let mut split = one.clone();
    let white = split.diffuse([0.9; 3]);
    let mut again = split.scene.shapes[0].clone();
    again.material = white;
    split.scene.shapes.push(again);
    let came = rendered(&one, 8, 8, 16).and_then(|one| {
        let off = difference(&rendered(&split, 8, 8, 16)?, &one);
        held(off < 1e-6, format!("largest difference {}", about(off)))
    });
    add("a grey floor and a coincident white floor".into(), "the image of the first floor", came);
    // Triangles a million times as long as wide, glowing in the dark: a ray that slips through one sees black.
    for distance in [0.2, 1.0] {
        let came = rendered(&slivers(distance, 1), 16, 16, 256).and_then(|film| {
            let off = (mean(&film) - 1.0).abs();
            held(off == 0.0, format!("off by {}", about(off)))
        });
        add(
            format!("triangles of 2 m by 2e-6 m side by side, glowing, seen from {distance} m"),
            "exactly 1: no ray passes between triangles",
            came,
        );
    }
    let came = rendered(&slivers(0.2, 2), 16, 16, 256).and_then(|film| within(&film, 0.5, 0.01));
    add("the same from 0.2 m, without every other pair".into(), "1/2, to 1%: no ray hits a missing triangle", came);
    // How near a hit is has to be known better than that it is before the camera.
    let came = rendered(&slivers(4.0, 1), 16, 16, 256).and_then(|film| {
        held(mean(&film) == 0.0, "no ray hits: triangles thinner than a millionth of their distance are missed".into())
    });
    add(
        "the same from 4 m, where the triangles are 5e-7 of their distance wide".into(),
        "no requirement: the result is reported",
        came,
    );
    // Seen from below, filling the view; paths end at the first thing that they meet.
    let mut heap = Built::new([2.5e-4, 0.9, 2.5e-4], [2.5e-4, 1.0, 2.5e-4], 0.1, 1);
    heap.scene.camera.up = [0.0, 0.0, 1.0];
    let black = heap.diffuse([0.0; 3]);
    let mesh = Mesh {
        positions: vec![[0.0, 1.0, 0.0], [1e-3, 1.0, 0.0], [0.0, 1.0, 1e-3]],
        triangles: vec![[0, 1, 2]; 1_000_000],
        ..Mesh::default()
    };
    let mut points = heap.clone();
    heap.mesh(&mesh, IDENTITY, black).emission = Some(Texture::scalar(0.5));
    let came = world(&heap).and_then(|world| {
        let off = (mean(&rendered(&heap, 8, 8, 4)?) - 0.5).abs();
        let count = world.primitive_count();
        held(count == 1_000_000 && off == 0.0, format!("{count} primitives; off by {}", about(off)))
    });
    add("a million coincident triangles, glowing at 1/2, which fill the view".into(), "exactly 1/2", came);
    points.sky([1.0; 3]);
    let mesh = Mesh { positions: vec![[0.0, 1.0, 0.0]; 3], triangles: vec![[0, 1, 2]; 1_000_000], ..Mesh::default() };
    points.mesh(&mesh, IDENTITY, black);
    let came = world(&points).and_then(|world| {
        let (count, off) = (world.dropped.degenerate, (mean(&rendered(&points, 8, 8, 4)?) - 1.0).abs());
        held(count == 1_000_000 && off == 0.0, format!("{count} omitted and counted; the sky off by {}", about(off)))
    });
    add("a million triangles without area, before a sky of 1".into(), "omitted and counted; exactly the sky", came);
    broken(add);
}

/// A ball that fills the view, of whose corners in front one is at NaN and one at infinity.
fn broken(add: Add<'_>) {
    const BAD: [u32; 2] = [40, 41];
    let seen = |mesh: &Mesh| {
        let mut built = Built::new([0.0, 0.5, 2.0], [0.0, 0.5, 0.0], 20.0, 4);
        let grey = built.diffuse([0.5; 3]);
        built.mesh(mesh, columns([0.3, 0.0, 0.0], [0.0, 0.3, 0.0], [0.0, 0.0, 0.3], [0.0, 0.5, 0.0]), grey);
        built.sky([1.0; 3]);
        built
    };
    let (whole, mut bad, mut rest) = (ball(8), ball(8), ball(8));
    bad.positions[BAD[0] as usize] = [f32::NAN, 0.0, 0.0];
    bad.positions[BAD[1] as usize] = [f32::INFINITY, 0.0, 0.0];
    rest.triangles.retain(|triangle| !BAD.iter().any(|corner| triangle.contains(corner)));
    let left_out = (whole.triangles.len() - rest.triangles.len()) as u64;
    let came = world(&seen(&bad)).and_then(|world| {
        let film = rendered(&seen(&bad), 16, 16, 16)?;
        let same = film.mean() == rendered(&seen(&rest), 16, 16, 16)?.mean();
        // Were the hole not in view, the row could not fail.
        let hole = difference(&film, &rendered(&seen(&whole), 16, 16, 16)?);
        let count = world.dropped.not_finite;
        held(
            same && hole > 0.1 && count == left_out,
            format!("{count} triangles omitted and counted; the same bits, and a hole in view"),
        )
    });
    add(
        "a ball in view, with one vertex at NaN and one at infinity".into(),
        "the triangles of these vertices are omitted and counted: the image of a ball without them",
        came,
    );
}

/// What makes a scene into another.
type Change = fn(&mut Built);

fn cameras(add: Add<'_>) {
    // Above a floor of albedo 1/2 under a sky of 1.
    let above = |distance: f64, near: f64| {
        let mut built = floor_point();
        built.sky([1.0; 3]);
        built.scene.camera.origin = [0.0, distance, 0.0];
        built.scene.camera.target = [0.0, distance - 1.0, 0.0];
        built.scene.camera.up = [0.0, 0.0, 1.0];
        built.scene.camera.fov_x = 40.0;
        built.scene.camera.near = near;
        built
    };
    for distance in [1e-6, 1e-3, 1e6] {
        // Far away, the floor has to be as large as the view.
        let mut built = above(distance, 0.0);
        built.scene.shapes[0]
            .to_world
            .iter_mut()
            .for_each(|row| row[..3].iter_mut().for_each(|v| *v *= distance.max(1.0)));
        let came = rendered(&built, 8, 8, 1024).and_then(|film| within(&film, 0.5, 2e-3));
        add(format!("a camera {distance:.0e} m above a floor of albedo 1/2 under a sky of 1"), "1/2, to 0.2%", came);
    }
    for (near, expected) in [(0.0, 0.5), (9e-7, 0.5), (1.1e-6, 1.0), (1e30, 1.0)] {
        // The sky has no noise.
        let (what, tolerance) = if expected < 1.0 { ("the floor: 1/2, to 0.2%", 2e-3) } else { ("the sky: 1", 0.0) };
        let came = rendered(&above(1e-6, near), 8, 8, 1024).and_then(|film| within(&film, expected, tolerance));
        add(format!("the same camera at 1e-6 m with a near plane at {near:.1e} m"), what, came);
    }
    for fov in [1e-6, 1e-2, 179.0, 179.999] {
        let mut built = glowing(0.5, 1000);
        built.scene.camera.fov_x = fov;
        // The near plane is nowhere near the view's edges.
        built.scene.camera.near = 0.0;
        let came = rendered(&built, 8, 8, 1024).and_then(|film| within(&film, 2.0, 0.01));
        add(format!("a field of view of {fov} degrees inside the glowing cube"), "2, to 1%", came);
    }
    let looks: [(&str, Change); 6] = [
        ("whose target is its origin", |b| b.scene.camera.target = b.scene.camera.origin),
        ("whose up vector is its viewing direction", |b| b.scene.camera.up = [0.0, -0.5, -2.0]),
        ("with a field of view of 180 degrees", |b| b.scene.camera.fov_x = 180.0),
        ("at NaN", |b| b.scene.camera.origin[1] = f64::NAN),
        ("1e39 m away", |b| b.scene.camera.origin[1] = 1e39),
        ("with a near plane at 1e39 m", |b| b.scene.camera.near = 1e39),
    ];
    for (what, change) in looks {
        let mut built = floor_point();
        built.sky([1.0; 3]);
        change(&mut built);
        let came = match rendered(&built, 2, 2, 1) {
            Err(told) => held(told.contains("the camera"), "refused, with the remedy".into()),
            Ok(_) => Err("accepted".into()),
        };
        add(format!("a camera {what}"), "refused with a specific error", came);
    }
}
