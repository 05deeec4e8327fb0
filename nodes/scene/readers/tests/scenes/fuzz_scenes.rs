//! The readers of whole scenes meet files that nobody would write: sound Mitsuba and pbrt scenes with their meshes,
//! mangled by word, by line and by byte. They may refuse a scene, in lines that name file, place and remedy. They may
//! not panic, take long, or take much memory.
//!
//! `TAUFLOW_FUZZ_SECONDS` and `TAUFLOW_FUZZ_SEED` are those of [`crate::fuzz`].

use crate::{
    fuzz::{held_by, mangle_bytes},
    small_assets::folder,
};
use std::{
    collections::BTreeMap,
    fs,
    panic::{AssertUnwindSafe, catch_unwind},
    time::{Duration, Instant},
};
use tauflow_contract::KindError;
use tauflow_data::{Image, image_io::encode_png, rng::Stream};
use tauflow_scene_readers::{Options, load_scene};

const MITSUBA: &str = r##"<scene version="3.0.0">
<default name="depth" value="6"/>
<default name="file" value="m.ply"/>
<integrator type="path"><integer name="max_depth" value="$depth"/></integrator>
<sensor type="perspective"><float name="fov" value="40"/><string name="fov_axis" value="y"/>
<float name="near_clip" value="0.1"/>
<transform name="to_world"><lookat origin="0,1,5" target="0,0,0" up="0,1,0"/></transform>
<film type="hdrfilm"><integer name="width" value="64"/><integer name="height" value="48"/><rfilter type="box"/></film>
<sampler type="independent"><integer name="sample_count" value="16"/></sampler></sensor>
<sensor type="perspective"><string name="focal_length" value="35mm"/></sensor>
<bsdf type="twosided" id="wall"><bsdf type="diffuse"><texture type="bitmap" name="reflectance">
<string name="filename" value="t.png"/><transform name="to_uv"><scale x="2" y="3"/></transform></texture></bsdf></bsdf>
<bsdf type="roughconductor" id="metal"><string name="material" value="Au"/><float name="alpha" value="0.2"/>
<string name="distribution" value="ggx"/></bsdf>
<bsdf type="blendbsdf" id="mix"><float name="weight" value="0.3"/><ref id="metal"/><bsdf type="plastic">
<rgb name="diffuse_reflectance" value="#3080ff"/><float name="int_ior" value="1.6"/></bsdf></bsdf>
<bsdf type="mask" id="hole"><texture type="checkerboard" name="opacity"><float name="color0" value="0"/></texture>
<bsdf type="principled"><float name="roughness" value="0.4"/><float name="spec_trans" value="0.5"/></bsdf></bsdf>
<shape type="ply"><string name="filename" value="$file"/><ref id="wall"/></shape>
<shape type="obj"><string name="filename" value="m.obj"/><ref id="mix"/>
<boolean name="face_normals" value="true"/></shape>
<shape type="sphere"><point name="center" x="0" y="1" z="0"/><float name="radius" value="0.5"/>
<bsdf type="dielectric"><string name="int_ior" value="bk7"/></bsdf></shape>
<shape type="cylinder"><point name="p1" value="0,0,3"/><ref id="hole"/></shape>
<shape type="shapegroup" id="group"><shape type="cube"/><shape type="disk"/></shape>
<shape type="instance"><ref id="group"/><transform name="to_world"><rotate y="1" angle="30"/>
<translate x="1"/><matrix value="1 0 0 0 0 1 0 0 0 0 1 0 0 0 0 1"/></transform></shape>
<shape type="rectangle"><emitter type="area"><spectrum name="radiance" value="400:1, 500:2, 700:3"/></emitter></shape>
<emitter type="envmap"><string name="filename" value="sky.hdr"/><float name="scale" value="2"/></emitter>
<emitter type="point"><point name="position" value="0 5 0"/><rgb name="intensity" value="1,2,3"/></emitter>
<emitter type="spot"><float name="cutoff_angle" value="30"/></emitter>
<include filename="more.xml"/>
</scene>
"##;

const MORE: &str = r#"<scene version="3.0.0">
<shape type="disk"><bsdf type="thindielectric"/></shape>
<alias id="metal" as="gold"/>
</scene>
"#;

const PBRT: &str = r#"LookAt 0 1 5  0 0 0  0 1 0
Camera "perspective" "float fov" [ 45 ]
Film "rgb" "integer xresolution" 64 "integer yresolution" 48
Integrator "path" "integer maxdepth" 8
Sampler "halton" "integer pixelsamples" 16
WorldBegin
LightSource "distant" "blackbody L" 5000 "float scale" 2
LightSource "infinite" "rgb L" [ .4 .5 .6 ]
Texture "t" "spectrum" "imagemap" "string filename" "t.png" "float uscale" 2
Texture "c" "float" "checkerboard" "float tex1" 0 "float tex2" 1
Texture "s" "spectrum" "scale" "texture tex" "t" "texture scale" "c"
MakeNamedMaterial "wall" "string type" "diffuse" "texture reflectance" "s"
MakeNamedMaterial "metal" "string type" "conductor" "spectrum eta" "metal-Au-eta" "spectrum k" "metal-Au-k"
AttributeBegin
Translate 0 1 0
Rotate 30 0 1 0
Scale 1 2 1
NamedMaterial "wall"
Shape "trianglemesh" "point3 P" [0 0 0 1 0 0 0 1 0 1 1 0] "integer indices" [0 1 2 1 3 2]
"point2 uv" [0 0 1 0 0 1 1 1]
Shape "bilinearmesh" "point3 P" [0 0 0 1 0 0 0 1 0 1 1 1]
Shape "plymesh" "string filename" "m.ply" "texture alpha" "c"
AttributeEnd
ObjectBegin "o"
Material "mix" "string materials" ["wall" "metal"] "float amount" 0.3
Shape "sphere" "float radius" 0.5 "float phimax" 270
Shape "disk" "float innerradius" 0.2
Shape "cylinder" "float zmin" 0
ObjectEnd
ObjectInstance "o"
CoordinateSystem "here"
ConcatTransform [1 0 0 0 0 1 0 0 0 0 1 0 2 0 0 1]
CoordSysTransform "here"
ReverseOrientation
AreaLightSource "diffuse" "rgb L" [ 3 3 3 ]
Material "coateddiffuse" "float roughness" 0.1
Shape "sphere" "float radius" 0.1
Include "more.pbrt"
"#;

const PLY: &str = "ply\nformat ascii 1.0\nelement vertex 4\nproperty float x\nproperty float y\nproperty float z\n\
    property float u\nproperty float v\nelement face 2\nproperty list uchar int vertex_indices\nend_header\n\
    0 0 0 0 0\n1 0 0 1 0\n1 1 0 1 1\n0 1 0 0 1\n3 0 1 2\n4 0 1 2 3\n";

const OBJ: &str = "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nvt 0 0\nvt 1 1\nvn 0 0 1\nf 1/1/1 2/1/1 3/2/1 4/1/1\n";

/// Words that fields may hold: at the edges of numbers, and such as mean something to a reader.
const WORDS: [&str; 34] = [
    "-1",
    "0",
    "1",
    "1e-40",
    "1e39",
    "1e300",
    "nan",
    "inf",
    "65536",
    "4294967295",
    "0.5",
    "true",
    "\"",
    "<",
    ">",
    "[",
    "]",
    "$depth",
    "../x",
    "m.ply",
    "t.png",
    "sphere",
    "instance",
    "mask",
    "twosided",
    "normalmap",
    "bitmap",
    "envmap",
    "shapegroup",
    "AttributeBegin",
    "ObjectInstance",
    "Include",
    "mix",
    "360",
];

fn words(text: &str) -> Vec<(usize, usize)> {
    let mut found = Vec::new();
    let mut start = None;
    for (at, c) in text.char_indices().chain([(text.len(), ' ')]) {
        let inside = c.is_ascii_alphanumeric() || matches!(c, '.' | '-' | '_' | '$' | '#');
        match (start, inside) {
            (None, true) => start = Some(at),
            (Some(from), false) => {
                found.push((from, at));
                start = None;
            }
            _ => {}
        }
    }
    found
}

/// A text in which a few words are others, or lines are lost, repeated or moved.
fn mangle_text(sound: &str, draw: &mut Stream) -> String {
    let mut text = sound.to_owned();
    for _ in 0..1 + draw.below(4) {
        if draw.chance(0.25) {
            let mut lines: Vec<&str> = text.lines().collect();
            let at = draw.below(lines.len().max(1)).min(lines.len());
            let to = (at + 1 + draw.below(3)).min(lines.len());
            let piece: Vec<&str> = lines[at..to].to_vec();
            match draw.below(3) {
                0 => drop(lines.drain(at..to)),
                1 => drop(lines.splice(at..at, piece.repeat(1 + draw.below(40)))),
                _ => {
                    let other = draw.below(lines.len().max(1));
                    lines.splice(other..other, piece);
                }
            }
            text = lines.join("\n");
            continue;
        }
        let places = words(&text);
        let Some((from, to)) = places.get(draw.below(places.len().max(1))).copied() else { break };
        let (a, b) = places[draw.below(places.len())];
        let own = text[a..b].to_owned();
        let word = if draw.chance(0.4) { own.as_str() } else { WORDS[draw.below(WORDS.len())] };
        text.replace_range(from..to, word);
    }
    text
}

fn serialized() -> Vec<u8> {
    use flate2::{Compression, write::ZlibEncoder};
    use std::io::Write as _;
    let mut body = 2u32.to_le_bytes().to_vec();
    body.push(0);
    body.extend([3u64, 1].iter().flat_map(|n| n.to_le_bytes()));
    body.extend([0.0f32, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0].iter().flat_map(|v| v.to_le_bytes()));
    body.extend([0.0f32, 0.0, 1.0, 0.0, 0.0, 1.0].iter().flat_map(|v| v.to_le_bytes()));
    body.extend([0u32, 1, 2].iter().flat_map(|i| i.to_le_bytes()));
    let mut zip = ZlibEncoder::new(vec![0x1c, 0x04, 4, 0], Compression::default());
    zip.write_all(&body).expect("in memory");
    zip.finish().expect("in memory")
}

/// Sound scenes: files by name, the scene's own first.
fn scenes() -> Vec<Vec<(&'static str, Vec<u8>)>> {
    let mut picture = Image::new(4, 4, 3);
    picture.data_mut().iter_mut().enumerate().for_each(|(i, v)| *v = i as f32 / 48.0);
    let png = encode_png(&picture).expect("a picture");
    let sky = b"#?RGBE\n\n-Y 1 +X 2\n\x80\x40\x20\x81\x80\x80\x80\x80".to_vec();
    let packed = MITSUBA.replace("m.obj", "m.serialized").replace("\"obj\"", "\"serialized\"");
    let text = |text: &str| text.as_bytes().to_vec();
    vec![
        vec![
            ("a.xml", text(MITSUBA)),
            ("more.xml", text(MORE)),
            ("m.ply", text(PLY)),
            ("m.obj", text(OBJ)),
            ("t.png", png.clone()),
            ("sky.hdr", sky.clone()),
        ],
        vec![
            ("a.xml", text(&packed)),
            ("more.xml", text(MORE)),
            ("m.ply", text(PLY)),
            ("m.serialized", serialized()),
            ("t.png", png.clone()),
            ("sky.hdr", sky),
        ],
        vec![("a.pbrt", text(PBRT)), ("more.pbrt", text("Shape \"sphere\"\n")), ("m.ply", text(PLY)), ("t.png", png)],
    ]
}

#[test]
#[expect(clippy::disallowed_methods, reason = "it looks for a time, and for how long single scenes take")]
fn fuzz_scenes() {
    let env = |name: &str| std::env::var(name).ok().and_then(|text| text.parse::<f64>().ok());
    let seconds = env("TAUFLOW_FUZZ_SECONDS").unwrap_or(3.0);
    let scenes = scenes();
    let mut draw = Stream::new(env("TAUFLOW_FUZZ_SEED").unwrap_or(1.0) as u64, &[0x5CE]);
    let place = folder("fuzz_scenes");
    let begun = Instant::now();
    let mut counts: BTreeMap<&str, [u64; 2]> = BTreeMap::new();
    let (mut slowest, mut largest) = (Duration::ZERO, 0);
    for turn in 0u64.. {
        if begun.elapsed().as_secs_f64() >= seconds {
            break;
        }
        let scene = &scenes[draw.below(scenes.len())];
        // The first turns read each scene as it is, and some turns damage what a scene names.
        let damaged = if draw.chance(0.7) { 0 } else { draw.below(scene.len()) };
        let scene = if turn < scenes.len() as u64 { &scenes[turn as usize] } else { scene };
        for (index, (name, sound)) in scene.iter().enumerate() {
            let bytes = match (index == damaged && turn >= scenes.len() as u64, std::str::from_utf8(sound)) {
                (true, Ok(text)) if draw.chance(0.8) => mangle_text(text, &mut draw).into_bytes(),
                (true, _) => mangle_bytes(sound, &scene[draw.below(scene.len())].1, &mut draw),
                (false, _) => sound.clone(),
            };
            fs::write(place.join(name), bytes).expect("writable");
        }
        let own = scene[0].0;
        let options = Options { approximate: true, ..Options::default() };
        let path = place.join(own);
        let from = Instant::now();
        let (done, held) =
            held_by(|| catch_unwind(AssertUnwindSafe(|| load_scene(&path, None, draw.below(2), options))));
        let took = from.elapsed();
        let told = |what: String| -> ! {
            let kept = folder("fuzz_scenes_failed");
            for (name, _) in scene {
                fs::copy(place.join(name), kept.join(name)).expect("writable");
            }
            panic!("{what}: {}", kept.join(own).display())
        };
        let Ok(result) = done else { told("it panicked".into()) };
        if turn < scenes.len() as u64 && result.is_err() {
            told(format!("a sound scene is refused: {result:?}"));
        }
        match &result {
            Ok(_) => {}
            Err(KindError::Input(text)) => {
                for line in text.lines().filter(|line| !(line.starts_with("and ") && line.ends_with(" more"))) {
                    let named = scene.iter().any(|(name, _)| line.starts_with(name));
                    if !named || !line.contains("; ") || line.len() > 2000 {
                        told(format!("no line of file, place and remedy: {line}"));
                    }
                }
            }
            Err(other) => told(format!("no error of input: {other}")),
        }
        if took.as_secs() >= 10 || held > 1 << 30 {
            told(format!("it took {took:?} and {held} bytes"));
        }
        (slowest, largest) = (slowest.max(took), largest.max(held));
        counts.entry(own).or_default()[usize::from(result.is_ok())] += 1;
    }
    println!("refused and read: {counts:?}; the slowest took {slowest:?}, the largest {} MB", largest >> 20);
    for (name, [refused, read]) in counts {
        assert!(refused > 0 && read > 0, "{name}: scenes near what is right, and scenes that are wrong");
    }
}
