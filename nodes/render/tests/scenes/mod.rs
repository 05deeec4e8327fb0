//! Scenes built by hand, for tests and examples.
#![allow(dead_code, reason = "each test uses some of them")]

use std::collections::BTreeMap;
use tauflow_contract::{Digest, KindError};
use tauflow_data::{
    Image, Resolution,
    mesh::Mesh,
    scene::{Affine, Bsdf, Camera, Emitter, Geometry, IDENTITY, Recipe, Rgb, Scene, Shape, Texture},
};

/// A film of this size.
pub fn film(width: u32, height: u32) -> Resolution {
    Resolution::new(width, height).expect("sides that can be rendered")
}

/// A scene and its blobs.
#[derive(Clone)]
pub struct Built {
    /// The scene.
    pub scene: Scene,
    /// Its blobs.
    pub blobs: BTreeMap<Digest, Vec<u8>>,
}

impl Built {
    /// A scene without shapes, seen from `origin`.
    pub fn new(origin: [f64; 3], target: [f64; 3], fov_x: f64, max_depth: u32) -> Self {
        let camera = Camera { origin, target, up: [0.0, 1.0, 0.0], fov_x, near: 0.01 };
        let scene = Scene {
            hide_emitters: false,
            version: 1,
            seed: 11,
            camera,
            max_depth,
            shapes: Vec::new(),
            materials: Vec::new(),
            emitters: Vec::new(),
        };
        Self { scene, blobs: BTreeMap::new() }
    }

    /// Hands out blobs.
    pub fn load(&self, digest: &Digest) -> Result<Vec<u8>, KindError> {
        self.blobs.get(digest).cloned().ok_or(KindError::MissingBlob(*digest))
    }

    /// Adds a material.
    pub fn material(&mut self, bsdf: Bsdf) -> usize {
        self.scene.materials.push(bsdf);
        self.scene.materials.len() - 1
    }

    /// Adds a diffuse material.
    pub fn diffuse(&mut self, reflectance: Rgb) -> usize {
        self.material(Bsdf::Diffuse { reflectance: Texture::rgb(reflectance) })
    }

    /// Adds a shape.
    pub fn shape(&mut self, geometry: Geometry, to_world: Affine, material: usize) -> &mut Shape {
        self.scene.shapes.push(Shape { geometry, to_world, material, emission: None, flip_normals: false });
        self.scene.shapes.last_mut().expect("one was just added")
    }

    /// Adds a sphere.
    pub fn sphere(&mut self, center: [f64; 3], radius: f64, material: usize) -> &mut Shape {
        self.shape(Geometry::Sphere { center, radius }, IDENTITY, material)
    }

    /// Adds a mesh.
    pub fn mesh(&mut self, mesh: &Mesh, to_world: Affine, material: usize) -> &mut Shape {
        let bytes = mesh.to_bytes().expect("a small mesh");
        let digest = Digest::of(&bytes);
        self.blobs.insert(digest, bytes);
        self.shape(Geometry::Mesh { mesh: digest }, to_world, material)
    }

    /// Adds light from everywhere.
    pub fn sky(&mut self, radiance: Rgb) {
        self.scene.emitters.push(Emitter::Constant { radiance });
    }
}

/// The map whose columns are images of x, y, z and the origin.
pub fn columns(x: [f64; 3], y: [f64; 3], z: [f64; 3], shift: [f64; 3]) -> Affine {
    std::array::from_fn(|i| [x[i], y[i], z[i], shift[i]])
}

/// A square of half side `half` at `at`, facing up or down.
pub fn level(half: f64, at: [f64; 3], up: bool) -> Affine {
    if up {
        columns([half, 0.0, 0.0], [0.0, 0.0, -half], [0.0, half, 0.0], at)
    } else {
        columns([half, 0.0, 0.0], [0.0, 0.0, half], [0.0, -half, 0.0], at)
    }
}

/// A smooth ball of triangles, of radius 1.
pub fn ball(bands: u32) -> Mesh {
    use std::f64::consts::PI;
    let mut mesh = Mesh { uvs: Some(Vec::new()), ..Mesh::default() };
    for i in 0..=bands {
        for j in 0..=2 * bands {
            let (theta, phi) = (PI * f64::from(i) / f64::from(bands), PI * f64::from(j) / f64::from(bands));
            let p = [
                tauflow_data::maths::sin(theta) * tauflow_data::maths::cos(phi),
                tauflow_data::maths::cos(theta),
                tauflow_data::maths::sin(theta) * tauflow_data::maths::sin(phi),
            ];
            mesh.positions.push(p.map(|v| v as f32));
            let uv = [f64::from(j) / f64::from(2 * bands), f64::from(i) / f64::from(bands)];
            mesh.uvs.get_or_insert_default().push(uv.map(|v| v as f32));
        }
    }
    let at = |i: u32, j: u32| i * (2 * bands + 1) + j;
    for i in 0..bands {
        for j in 0..2 * bands {
            mesh.triangles.push([at(i, j), at(i, j + 1), at(i + 1, j)]);
            mesh.triangles.push([at(i, j + 1), at(i + 1, j + 1), at(i + 1, j)]);
        }
    }
    mesh.normals = Some(mesh.positions.clone());
    mesh
}

/// Diffuse balls on a floor under a sky.
pub fn balls_under_sky() -> Built {
    let mut built = Built::new([0.0, 2.0, 7.0], [0.0, 0.8, 0.0], 45.0, 6);
    let floor = built.diffuse([0.5; 3]);
    let (red, blue) = (built.diffuse([0.7, 0.2, 0.15]), built.diffuse([0.15, 0.3, 0.7]));
    built.shape(Geometry::Rectangle, level(10.0, [0.0; 3], true), floor);
    built.sphere([-1.2, 1.0, 0.0], 1.0, red);
    built.mesh(&ball(24), columns([1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [1.2, 1.0, 0.0]), blue);
    built.sky([0.8, 0.9, 1.0]);
    built
}

/// Something of everything: a sky of an odd size, a lamp and a spot, textures on spheres and disks, each sort of
/// material, a blend and a normal map.
pub fn everything() -> Built {
    let mut built = Built::new([0.0, 2.0, 7.0], [0.0, 0.8, 0.0], 55.0, 6);
    let mut image = |width: usize, height: usize, value: &dyn Fn(usize) -> f32| {
        let data: Vec<f32> = (0..width * height * 3).map(value).collect();
        let bytes = Image::from_data(width, height, 3, data).expect("fits").to_bytes();
        let digest = Digest::of(&bytes);
        built.blobs.insert(digest, bytes);
        digest
    };
    let sky = image(7, 5, &|i| if i == 40 { 60.0 } else { 0.2 + (i % 5) as f32 * 0.1 });
    let colors = image(5, 3, &|i| 0.1 + (i * 7 % 11) as f32 * 0.07);
    let bumps = image(3, 3, &|i| [0.55, 0.45, 0.95, 0.4, 0.5, 0.9][i % 6]);
    let bitmap = |image| Texture::Bitmap {
        image,
        uv: [[3.0, 0.5, 0.0], [0.0, 2.0, 0.1]],
        scale: [1.0; 3],
        channel: None,
        clamp: false,
    };
    let half = || Texture::scalar(0.5);
    let painted = built.material(Bsdf::Diffuse { reflectance: bitmap(colors) });
    let metal = Bsdf::Conductor { eta: [0.2, 0.9, 1.1], k: [3.9, 2.4, 2.2], alpha: 0.2, specular_reflectance: half() };
    let glass = Bsdf::Dielectric {
        int_ior: 1.5,
        ext_ior: 1.0,
        alpha: 0.0,
        specular_reflectance: Texture::scalar(1.0),
        specular_transmittance: Texture::rgb([0.9, 1.0, 0.8]),
    };
    let thin = Bsdf::ThinDielectric {
        int_ior: 1.4,
        ext_ior: 1.0,
        specular_reflectance: Texture::scalar(1.0),
        specular_transmittance: bitmap(colors),
    };
    let plastic = Bsdf::Plastic { diffuse_reflectance: bitmap(colors), int_ior: 1.5, ext_ior: 1.0, alpha: 0.1 };
    let principled = Bsdf::Principled {
        base_color: bitmap(colors),
        metallic: half(),
        roughness: half(),
        specular: 0.5,
        spec_trans: Texture::scalar(0.3),
        clearcoat: 0.5,
        clearcoat_gloss: 0.8,
    };
    let rough = Bsdf::Dielectric {
        int_ior: 1.33,
        ext_ior: 1.0,
        alpha: 0.3,
        specular_reflectance: Texture::scalar(1.0),
        specular_transmittance: Texture::scalar(1.0),
    };
    let blend = Bsdf::Blend { weight: half(), a: Box::new(metal.clone()), b: Box::new(plastic.clone()) };
    let mapped = Bsdf::TwoSided {
        inner: Box::new(Bsdf::NormalMap { map: bitmap(bumps), scale: 0.7, inner: Box::new(plastic.clone()) }),
    };
    built.shape(Geometry::Rectangle, level(10.0, [0.0; 3], true), painted);
    for (k, bsdf) in [metal, glass, thin, plastic, principled, rough, blend, mapped].into_iter().enumerate() {
        let material = built.material(bsdf);
        let at = [-3.0 + 0.85 * k as f64, 0.5, 0.4 * (k % 3) as f64];
        if k % 2 == 0 {
            built.sphere(at, 0.45, material);
        } else {
            let (x, y, z) = ([0.4, 0.0, 0.1], [0.0, 0.4, 0.0], [-0.1, 0.0, 0.4]);
            built.mesh(&ball(8), columns(x, y, z, at), material);
        }
    }
    let tilted = columns([0.5, 0.0, 0.0], [0.0, 0.35, -0.35], [0.0, 0.35, 0.35], [1.5, 1.8, -0.5]);
    built.shape(Geometry::Disk, tilted, painted);
    built.shape(Geometry::Rectangle, level(0.4, [0.0, 3.0, 0.5], false), painted).emission = Some(bitmap(colors));
    let place = columns([1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0], [-1.0, 3.5, 0.0]);
    built.scene.emitters.push(Emitter::Spot {
        to_world: place,
        intensity: [9.0; 3],
        cutoff_angle: 30.0,
        beam_width: 20.0,
    });
    built.scene.emitters.push(Emitter::Envmap { image: sky, scale: 0.7, to_world: IDENTITY });
    built
}

/// Copies of two meshes, placed in every way: turned, mirrored, stretched, their normals turned round; with textures, a
/// normal map, vertex colours, an opacity, glass, and as lamps.
pub fn copies() -> Built {
    let mut built = Built::new([0.0, 2.0, 7.0], [0.0, 0.8, 0.0], 55.0, 6);
    let mut image = |width: usize, height: usize, value: &dyn Fn(usize) -> f32| {
        let data: Vec<f32> = (0..width * height * 3).map(value).collect();
        let bytes = Image::from_data(width, height, 3, data).expect("fits").to_bytes();
        let digest = Digest::of(&bytes);
        built.blobs.insert(digest, bytes);
        digest
    };
    let colors = image(5, 3, &|i| 0.1 + (i * 7 % 11) as f32 * 0.07);
    let bumps = image(3, 3, &|i| [0.55, 0.45, 0.95, 0.4, 0.5, 0.9][i % 6]);
    let holes = image(8, 8, &|i| [1.0, 0.4, 0.0][i / 3 % 3]);
    let bitmap = |image| Texture::Bitmap {
        image,
        uv: [[3.0, 0.5, 0.0], [0.0, 2.0, 0.1]],
        scale: [1.0; 3],
        channel: None,
        clamp: false,
    };
    let painted = Bsdf::Diffuse { reflectance: bitmap(colors) };
    let plastic = Bsdf::Plastic { diffuse_reflectance: bitmap(colors), int_ior: 1.5, ext_ior: 1.0, alpha: 0.1 };
    let mapped = Bsdf::TwoSided {
        inner: Box::new(Bsdf::NormalMap { map: bitmap(bumps), scale: 0.7, inner: Box::new(plastic.clone()) }),
    };
    let hole = Texture::Bitmap {
        image: holes,
        uv: [[2.0, 0.0, 0.0], [0.0, 2.0, 0.0]],
        scale: [1.0; 3],
        channel: Some(0),
        clamp: false,
    };
    let two_sided = Box::new(Bsdf::TwoSided { inner: Box::new(painted.clone()) });
    let masked = Bsdf::Mask { opacity: hole, inner: two_sided };
    let glass = Bsdf::Dielectric {
        int_ior: 1.5,
        ext_ior: 1.0,
        alpha: 0.0,
        specular_reflectance: Texture::scalar(1.0),
        specular_transmittance: Texture::rgb([0.9, 1.0, 0.8]),
    };
    let tinted = Bsdf::TwoSided {
        inner: Box::new(Bsdf::Diffuse { reflectance: Texture::VertexColor { scale: [0.8; 3], channel: None } }),
    };
    let floor = built.diffuse([0.5; 3]);
    built.shape(Geometry::Rectangle, level(10.0, [0.0; 3], true), floor);
    let mut smooth = ball(8);
    let along = |p: &[f32; 3]| [-p[2], 0.0, p[0], 1.0];
    smooth.tangents = Some(smooth.positions.iter().map(along).collect());
    smooth.colors = Some(smooth.positions.iter().map(|p| [p[0] * p[0], p[1] * p[1], p[2] * p[2], 1.0]).collect());
    let flat = Mesh { normals: None, tangents: None, uvs: None, ..smooth.clone() };
    let bare = Mesh { tangents: None, ..smooth.clone() };
    let sorts = [painted, plastic, mapped, masked, glass, tinted];
    let materials: Vec<usize> = sorts.into_iter().map(|bsdf| built.material(bsdf)).collect();
    for (k, material) in materials.iter().enumerate() {
        for (row, mesh) in [&smooth, &bare, &flat].into_iter().enumerate() {
            if row == 2 && (2..=3).contains(&k) {
                continue;
            }
            let at = [-2.6 + 1.05 * k as f64, 0.45 + 0.1 * row as f64, 1.3 - 1.1 * row as f64];
            let (mut x, y, z) = ([0.4, 0.0, 0.1], [0.05, 0.4 - 0.07 * row as f64, 0.0], [-0.1, 0.1, 0.4]);
            if (k + row) % 3 == 1 {
                x = x.map(|v: f64| -v);
            }
            built.mesh(mesh, columns(x, y, z, at), *material).flip_normals = k != 4 && (k + row) % 4 == 2;
        }
    }
    // Two even lamps, one of them with a picture, and a stretched one.
    for (k, scale) in [[0.2; 3], [0.3; 3], [0.7, 0.4, 0.5]].into_iter().enumerate() {
        let ([a, b, c], at) = (scale, [-2.0 + 2.0 * k as f64, 2.6, 0.5]);
        let lamp = built.mesh(&bare, columns([a, 0.0, 0.0], [0.0, b, 0.0], [0.0, 0.0, c], at), floor);
        lamp.emission = Some(if k == 1 { bitmap(colors) } else { Texture::scalar(4.0 + k as f32) });
    }
    built.sky([0.3, 0.35, 0.4]);
    built
}

/// A closed room with a lamp under its ceiling, a block and a ball.
pub fn room() -> Built {
    let mut built = Built::new([0.0, 1.0, 3.2], [0.0, 1.0, 0.0], 50.0, 8);
    let white = built.diffuse([0.73; 3]);
    let (red, green) = (built.diffuse([0.63, 0.06, 0.05]), built.diffuse([0.14, 0.45, 0.09]));
    built.shape(Geometry::Rectangle, level(1.0, [0.0, 0.0, 0.0], true), white);
    built.shape(Geometry::Rectangle, level(1.0, [0.0, 2.0, 0.0], false), white);
    let (x, y, z) = ([1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]);
    built.shape(Geometry::Rectangle, columns(x, y, z, [0.0, 1.0, -1.0]), white);
    let minus = |v: [f64; 3]| v.map(|c: f64| -c);
    built.shape(Geometry::Rectangle, columns(minus(z), y, x, [-1.0, 1.0, 0.0]), red);
    built.shape(Geometry::Rectangle, columns(z, y, minus(x), [1.0, 1.0, 0.0]), green);
    let block = columns([0.28, 0.0, 0.1], [0.0, 0.6, 0.0], [-0.1, 0.0, 0.28], [-0.35, 0.6, -0.3]);
    built.shape(Geometry::Cube, block, white);
    built.mesh(&ball(32), columns([0.35, 0.0, 0.0], [0.0, 0.35, 0.0], [0.0, 0.0, 0.35], [0.4, 0.35, 0.25]), white);
    let lamp = built.shape(Geometry::Rectangle, level(0.3, [0.0, 1.99, 0.0], false), white);
    lamp.emission = Some(Texture::rgb([17.0, 12.0, 4.0]));
    built
}

/// One pixel of a floor of albedo 0.5, seen from the side at the origin; lights are to be added above.
pub fn floor_point() -> Built {
    let mut built = Built::new([0.0, 0.5, 2.0], [0.0, 0.0, 0.0], 1e-3, 2);
    let floor = built.diffuse([0.5; 3]);
    built.shape(Geometry::Rectangle, level(20.0, [0.0; 3], true), floor);
    built
}

/// The recipe of a scene built by hand.
pub fn recipe(exposure_ev: f64) -> Recipe {
    Recipe {
        stratum: "L0-open".into(),
        index: 0,
        content: None,
        view: 0,
        layout: "by-hand".into(),
        layout_params: BTreeMap::new(),
        objects: Vec::new(),
        environment: "none".into(),
        side: None,
        exposure_ev,
    }
}
