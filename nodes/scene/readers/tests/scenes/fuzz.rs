//! The readers of glTF, Radiance and OpenEXR meet files that nobody would write: sound ones, mangled. They may refuse,
//! in a line that names the file; they may not panic, take long, or take much memory.
//!
//! A few seconds of it are a test. `TAUFLOW_FUZZ_SECONDS=600 cargo test --release -p tauflow-scene-readers fuzz` goes
//! on for longer, `TAUFLOW_FUZZ_SEED` begins elsewhere. A file that fails is kept, and its path printed.

use crate::{
    reports::report_on,
    small_assets::{Data, folder, glb},
    support::{kind, shared},
};
use base64::{Engine as _, engine::general_purpose::STANDARD};
use serde_json::{Value, json as object};
use std::{
    alloc::{GlobalAlloc, Layout, System},
    cell::Cell,
    collections::BTreeMap,
    fs,
    panic::{AssertUnwindSafe, catch_unwind},
    time::{Duration, Instant},
};
use tauflow_data::{
    Image,
    image_io::{encode_png, write_exr},
    rng::Stream,
};

/// Counts what is allocated, and remembers the most there was.
struct Counting;

thread_local! {
    // Of this thread alone: other tests allocate as well. What one thread takes and another gives back comes out below
    // 0.
    static NOW: Cell<isize> = const { Cell::new(0) };
    static MOST: Cell<isize> = const { Cell::new(0) };
}

fn count(bytes: isize) {
    let now = NOW.get() + bytes;
    NOW.set(now);
    MOST.set(MOST.get().max(now));
}

#[expect(unsafe_code, reason = "passes on to the system's allocator, and counts")]
// SAFETY: every call goes on to the system's allocator as it is.
unsafe impl GlobalAlloc for Counting {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        count(layout.size() as isize);
        // SAFETY: the caller keeps the same promises that the system's allocator asks for.
        unsafe { System.alloc(layout) }
    }

    unsafe fn dealloc(&self, at: *mut u8, layout: Layout) {
        count(-(layout.size() as isize));
        // SAFETY: `at` came from the system's allocator with this layout.
        unsafe { System.dealloc(at, layout) }
    }
}

#[global_allocator]
static ALLOCATOR: Counting = Counting;

/// Does something, and says how many bytes it held at most beyond those that were held before.
pub fn held_by<T>(work: impl FnOnce() -> T) -> (T, isize) {
    let before = NOW.get();
    MOST.set(before);
    let done = work();
    (done, MOST.get() - before)
}

/// Does something, and says how long this thread was at it. A machine that does other things as well takes longer.
#[expect(clippy::disallowed_methods, reason = "where the system does not say, time is that of the clock")]
pub fn timed<T>(work: impl FnOnce() -> T) -> (T, Duration) {
    let on_processor = || -> Option<Duration> {
        let told = fs::read_to_string("/proc/thread-self/schedstat").ok()?;
        Some(Duration::from_nanos(told.split_whitespace().next()?.parse().ok()?))
    };
    let (begun, before) = (Instant::now(), on_processor());
    let done = work();
    let took = on_processor().zip(before).map(|(now, before)| now.saturating_sub(before));
    (done, took.unwrap_or_else(|| begun.elapsed()))
}

/// Most that a file of those here may make a reader hold. A picture of few bytes may have 2^23 texels.
const MOST_BYTES: isize = 1 << 29;

/// A sound file.
struct Seed {
    ending: &'static str,
    bytes: Vec<u8>,
    /// The JSON and the buffer of a GLB, for damage that leaves its chunks alone.
    parts: Option<(String, Vec<u8>)>,
}

fn square() -> (Data, Value) {
    let mut data = Data::default();
    let positions = data.floats(&[0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 1.0, 1.0, 0.0, 0.0, 1.0, 0.5], "VEC3", 3);
    let normals = data.floats(&[0.0, 0.0, 1.0].repeat(4), "VEC3", 3);
    let tangents = data.floats(&[1.0, 0.0, 0.0, 1.0].repeat(4), "VEC4", 4);
    let uvs = data.floats(&[0.0, 0.0, 1.0, 0.0, 1.0, 1.0, 0.0, 1.0], "VEC2", 2);
    let colors = data.accessor(&[255, 0, 51, 255].repeat(4), 5121, "VEC4", 4, true);
    let indices: Vec<u8> = [0u16, 1, 2, 0, 2, 3].iter().flat_map(|v| v.to_le_bytes()).collect();
    let indices = data.accessor(&indices, 5123, "SCALAR", 6, false);
    let mut picture = Image::new(4, 4, 3);
    picture.data_mut().iter_mut().enumerate().for_each(|(i, v)| *v = i as f32 / 48.0);
    let png = encode_png(&picture).expect("a picture");
    let view = data.view(&png);
    let uri = format!("data:image/png;base64,{}", STANDARD.encode(&png));
    let sparse = data.accessor(&[0u8; 48], 5126, "VEC3", 4, false);
    let (index, value) = (data.view(&[1]), data.view(&1f32.to_le_bytes().repeat(3)));
    data.accessors[sparse]["sparse"] = object!({ "count": 1,
        "indices": { "bufferView": index, "componentType": 5121 }, "values": { "bufferView": value } });
    let attributes = object!({ "POSITION": positions, "NORMAL": normals, "TANGENT": tangents, "TEXCOORD_0": uvs,
        "COLOR_0": colors });
    let rest = object!({
        "extensionsUsed": ["KHR_materials_transmission", "KHR_texture_transform"],
        "images": [{ "bufferView": view, "mimeType": "image/png" }, { "uri": uri }],
        "samplers": [{ "wrapS": 33071, "magFilter": 9728 }],
        "textures": [{ "source": 0, "sampler": 0 }, { "source": 1 }],
        "materials": [
            { "pbrMetallicRoughness": { "baseColorTexture": { "index": 0, "extensions": { "KHR_texture_transform":
                { "offset": [0.25, 0], "rotation": 0.5, "scale": [2, 2] } } },
                "metallicRoughnessTexture": { "index": 1 } },
              "normalTexture": { "index": 1, "scale": 0.5 },
              "emissiveTexture": { "index": 0 }, "emissiveFactor": [1, 1, 0],
              "alphaMode": "MASK", "alphaCutoff": 0.4 },
            { "doubleSided": true, "extensions": { "KHR_materials_transmission": { "transmissionFactor": 0.75 },
              "KHR_materials_ior": { "ior": 1.4 }, "KHR_materials_clearcoat": { "clearcoatFactor": 0.5 },
              "KHR_materials_volume": { "thicknessFactor": 1, "attenuationDistance": 2 } } },
        ],
        "meshes": [{ "primitives": [{ "attributes": attributes, "indices": indices, "material": 0 },
            { "attributes": { "POSITION": sparse }, "mode": 5, "material": 1 }] }],
        "nodes": [{ "children": [1], "rotation": [0, 0.7, 0, 0.7], "scale": [2, 2, -2] },
            { "mesh": 0, "matrix": [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 5, 0, 7, 1] }],
        "scenes": [{ "nodes": [0] }],
        "scene": 0,
    });
    (data, rest)
}

fn seeds() -> Vec<Seed> {
    let (data, rest) = square();
    let whole = data.file(rest.clone());
    let length = u32::from_le_bytes([whole[12], whole[13], whole[14], whole[15]]) as usize;
    let text = String::from_utf8(whole[20..20 + length].to_vec()).expect("JSON");
    let mut apart: Value = serde_json::from_str(&text).expect("JSON");
    let buffer = format!("data:application/octet-stream;base64,{}", STANDARD.encode(&data.bytes));
    apart["buffers"][0]["uri"] = object!(buffer);
    let mut seeds = vec![
        Seed { ending: "glb", bytes: whole, parts: Some((text, data.bytes)) },
        Seed { ending: "gltf", bytes: apart.to_string().into_bytes(), parts: None },
    ];
    let (posed, rest) = crate::default_pose::posed();
    let whole = posed.file(rest);
    let length = u32::from_le_bytes([whole[12], whole[13], whole[14], whole[15]]) as usize;
    let text = String::from_utf8(whole[20..20 + length].to_vec()).expect("JSON");
    seeds.push(Seed { ending: "glb", bytes: whole, parts: Some((text, posed.bytes)) });
    let mut map = b"#?RADIANCE\nEXPOSURE=2\nFORMAT=32-bit_rle_rgbe\n\n-Y 2 +X 8\n".to_vec();
    for _ in 0..2 {
        map.extend([2, 2, 0, 8, 136, 128, 8, 1, 2, 3, 4, 5, 6, 7, 8, 136, 0, 136, 129]);
    }
    seeds.push(Seed { ending: "hdr", bytes: map, parts: None });
    let mut old = b"#?RGBE\n\n+X 4 -Y 2\n".to_vec();
    old.extend([128, 64, 32, 129, 1, 1, 1, 3].repeat(2));
    seeds.push(Seed { ending: "hdr", bytes: old, parts: None });
    let mut image = Image::new(24, 12, 3);
    image.data_mut().iter_mut().enumerate().for_each(|(i, v)| *v = i as f32);
    let path = folder("fuzz").join("map.exr");
    write_exr(&path, &[("", &image)]).expect("writable");
    seeds.push(Seed { ending: "exr", bytes: fs::read(&path).expect("written"), parts: None });
    if let Some(folder) = shared("gltf") {
        for name in ["Box.glb", "BoxVertexColors.glb", "glass-table.glb", "basic_sci-fi_crate.glb"] {
            let bytes = fs::read(std::path::Path::new(&folder).join(name)).expect("a shared file");
            if bytes.len() < 1 << 18 {
                seeds.push(Seed { ending: "glb", bytes, parts: None });
            }
        }
    }
    seeds
}

/// Numbers at the edges of what fields can hold.
const WORDS: [u32; 12] = [0, 1, 2, 7, 255, 65_535, 65_536, 1 << 24, i32::MAX as u32, 1 << 31, u32::MAX, 0x7FC0_0000];
const TEXTS: [&str; 22] = [
    "-1",
    "0",
    "1",
    "3",
    "255",
    "65536",
    "4294967295",
    "18446744073709551616",
    "1e39",
    "-1e-40",
    "0.5",
    "null",
    "true",
    "[]",
    "{}",
    "\"\"",
    "[0]",
    "[[[[[[[[",
    "\"data:;base64,AAAA\"",
    "\"../x\"",
    "5126",
    "\"VEC4\"",
];

fn mangle_text(text: &str, draw: &mut Stream) -> String {
    let mut bytes = text.as_bytes().to_vec();
    for _ in 0..1 + draw.below(3) {
        // A value becomes another one.
        let starts: Vec<usize> = (1..bytes.len()).filter(|i| matches!(bytes[i - 1], b':' | b'[' | b',')).collect();
        let Some(at) = starts.get(draw.below(starts.len().max(1))).copied() else { break };
        let end = at + bytes[at..].iter().position(|b| matches!(b, b',' | b'}' | b']')).unwrap_or(0);
        let value = match draw.below(4) {
            0 => bytes[at..end].repeat(2),
            1 => Vec::new(),
            _ => TEXTS[draw.below(TEXTS.len())].as_bytes().to_vec(),
        };
        bytes.splice(at..end, value);
    }
    String::from_utf8_lossy(&bytes).into_owned()
}

fn mangle(seed: &Seed, other: &Seed, draw: &mut Stream) -> Vec<u8> {
    if let Some((text, buffer)) = seed.parts.as_ref().filter(|_| draw.chance(0.6)) {
        return glb(&mangle_text(text, draw), buffer);
    }
    if seed.ending == "gltf" && draw.chance(0.6) {
        return mangle_text(&String::from_utf8_lossy(&seed.bytes), draw).into_bytes();
    }
    mangle_bytes(&seed.bytes, &other.bytes, draw)
}

/// Bytes with pieces cut out, repeated, put in from another file, or made numbers at the edges.
pub fn mangle_bytes(sound: &[u8], other: &[u8], draw: &mut Stream) -> Vec<u8> {
    let mut bytes = sound.to_vec();
    for _ in 0..1 + draw.below(5) {
        // Half of the damage goes to the first half kilobyte, where headers are.
        let reach = if draw.chance(0.5) { bytes.len().min(512) } else { bytes.len() };
        let at = draw.below(reach + 1).min(bytes.len());
        let to = (at + 1 + draw.below(64)).min(bytes.len());
        match draw.below(7) {
            0 => bytes.truncate(at),
            1 => drop(bytes.drain(at..to)),
            2 => {
                let piece = bytes[at..to].repeat(1 + draw.below(8));
                bytes.splice(at..at, piece);
            }
            3 => {
                let from = draw.below(other.len());
                let piece = other[from..(from + 64).min(other.len())].to_vec();
                bytes.splice(at..to, piece);
            }
            4 if at + 4 <= bytes.len() => {
                bytes[at..at + 4].copy_from_slice(&WORDS[draw.below(WORDS.len())].to_le_bytes());
            }
            _ if at < bytes.len() => bytes[at] = draw.bits() as u8,
            _ => {}
        }
    }
    bytes
}

#[test]
#[expect(clippy::disallowed_methods, reason = "it looks for a time, and for how long single files take")]
fn fuzz() {
    let env = |name: &str| std::env::var(name).ok().and_then(|text| text.parse::<f64>().ok());
    let seconds = env("TAUFLOW_FUZZ_SECONDS").unwrap_or(3.0);
    let kind = kind("assets");
    let params = kind.resolve(&object!({ "files": ["unused"], "max_texture": 16 })).expect("fine params");
    let seeds = seeds();
    let mut draw = Stream::new(env("TAUFLOW_FUZZ_SEED").unwrap_or(1.0) as u64, &[]);
    let begun = Instant::now();
    let mut counts: BTreeMap<&str, [u64; 2]> = BTreeMap::new();
    let (mut slowest, mut largest) = (Duration::ZERO, 0);
    while begun.elapsed().as_secs_f64() < seconds {
        let seed = &seeds[draw.below(seeds.len())];
        let bytes = mangle(seed, &seeds[draw.below(seeds.len())], &mut draw);
        let name = format!("mangled.{}", seed.ending);
        let act = AssertUnwindSafe(|| report_on(kind.as_ref(), &params, &name, &bytes));
        let ((done, held), took) = timed(|| held_by(|| catch_unwind(act)));
        let told = |what: String| -> ! {
            let path = folder("fuzz").join(format!("failed.{}", seed.ending));
            fs::write(&path, &bytes).expect("writable");
            panic!("{what}: {}", path.display())
        };
        let Ok(report) = done else { told("it panicked".into()) };
        if let Some(line) = &report.reason
            && (report.accepted || !line.starts_with(&name) || line.contains('\n') || !line.contains("; "))
        {
            told(format!("no line of file, place and remedy: {line}"));
        }
        if took.as_secs() >= 10 || held > MOST_BYTES {
            told(format!("it took {took:?} and {held} bytes"));
        }
        (slowest, largest) = (slowest.max(took), largest.max(held));
        counts.entry(seed.ending).or_default()[usize::from(report.accepted)] += 1;
    }
    println!("refused and accepted: {counts:?}; the slowest took {slowest:?}, the largest {} MB", largest >> 20);
    for (ending, [refused, accepted]) in counts {
        assert!(refused > 0 && accepted > 0, "{ending}: files near what is right, and files that are wrong");
    }
}
