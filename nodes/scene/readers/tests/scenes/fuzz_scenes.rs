//! The readers of whole scenes meet files that nobody would write: sound scenes of Mitsuba, pbrt, glTF and our own with
//! their meshes, mangled by word, by line and by byte. They may refuse a scene, in lines that name file, place and
//! remedy. They may not panic, take long, or take much memory.
//!
//! `TAUFLOW_FUZZ_SECONDS` and `TAUFLOW_FUZZ_SEED` are those of [`crate::fuzz`].

use crate::{
    fuzz::{held_by, mangle_bytes, timed},
    small_assets::folder,
};
use serde_json::json;
use std::{
    collections::BTreeMap,
    fs,
    panic::{AssertUnwindSafe, catch_unwind},
    time::{Duration, Instant},
};
use tauflow_contract::{Digest, KindError};
use tauflow_data::{Image, image_io::encode_png, mesh::Mesh, rng::Stream};
use tauflow_scene_readers::{Options, load_scene};

const MITSUBA: &str = r##"<scene version="3.0.0">
<default name="depth" value="6"/>
<default name="file" value="m.ply"/>
<path value="."/>
<integrator type="moment"><integrator type="path"><integer name="max_depth" value="$depth"/>
<boolean name="hide_emitters" value="false"/><integer name="rr_depth" value="5"/></integrator></integrator>
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
<bsdf type="bumpmap" id="dented"><texture type="bitmap" name="bumps"><string name="filename" value="t.png"/>
<boolean name="raw" value="true"/><string name="wrap_mode" value="clamp"/></texture><float name="scale" value="0.1"/>
<bsdf type="roughplastic"><float name="alpha" value="0.2"/><boolean name="nonlinear" value="true"/></bsdf></bsdf>
<bsdf type="normalmap" id="carved"><texture type="bitmap" name="normalmap"><string name="filename" value="t.png"/>
</texture><bsdf type="roughdielectric"><float name="alpha_u" value="0.2"/><float name="alpha_v" value="0.2"/></bsdf>
</bsdf>
<emitter type="area" id="lamp"><spectrum type="blackbody" name="radiance"><float name="temperature" value="5000"/>
</spectrum></emitter>
<shape type="merge"><shape type="rectangle"><ref id="dented"/><ref id="lamp"/></shape></shape>
<shape type="rectangle"><ref id="carved"/><boolean name="flip_normals" value="true"/></shape>
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

const PBRT: &str = r#"Scale -1 1 1
LookAt 0 1 5  0 0 0  0 1 0
Camera "perspective" "float fov" [ 45 ]
Film "rgb" "integer xresolution" 64 "integer yresolution" 48
Integrator "path" "integer maxdepth" 8
Sampler "halton" "integer pixelsamples" 16
WorldBegin
Option "seed" 3
ColorSpace "rec2020"
LightSource "distant" "blackbody L" 5000 "float scale" 2
LightSource "spot" "rgb I" [ 1 2 3 ] "float coneangle" 30 "float conedeltaangle" 5 "point3 from" [ 0 2 0 ]
Attribute "light" "float scale" 2
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
Material "conductor" "float uroughness" .1 "float vroughness" .3 "bool remaproughness" false
Shape "bilinearmesh" "point3 P" [0 0 0 1 0 0 0 1 0 1 1 1] "integer indices" [0 1 2 3]
Material "diffuse" "string normalmap" "t.png"
TransformBegin
Shape "plymesh" "string filename" "m.ply"
TransformEnd
Include "more.pbrt"
Import "more.pbrt"
"#;

const PLY: &str = "ply\nformat ascii 1.0\nelement vertex 4\nproperty float x\nproperty float y\nproperty float z\n\
    property float u\nproperty float v\nelement face 2\nproperty list uchar int vertex_indices\nend_header\n\
    0 0 0 0 0\n1 0 0 1 0\n1 1 0 1 1\n0 1 0 0 1\n3 0 1 2\n4 0 1 2 3\n";

const OBJ: &str = "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nvt 0 0\nvt 1 1\nvn 0 0 1\nf 1/1/1 2/1/1 3/2/1 4/1/1\n";

/// A glTF file whose buffer is `m.bin`.
const GLTF: &str = r#"{ "asset": { "version": "2.0" }, "scene": 0, "scenes": [{ "nodes": [0, 1, 2, 3] }],
"extensionsUsed": ["KHR_lights_punctual", "EXT_mesh_gpu_instancing", "KHR_materials_transmission"],
"extensions": { "KHR_lights_punctual": { "lights": [{ "type": "spot", "color": [1, 0.5, 0.25], "intensity": 20,
"spot": { "innerConeAngle": 0.1, "outerConeAngle": 0.5 } }, { "type": "directional" }] } },
"nodes": [{ "camera": 0, "translation": [0, 0, 5] }, { "extensions": { "KHR_lights_punctual": { "light": 0 } },
"children": [4] }, { "mesh": 0, "rotation": [0, 0.7, 0, 0.7], "scale": [2, 2, -2],
"extensions": { "EXT_mesh_gpu_instancing": { "attributes": { "TRANSLATION": 2 } } } }, { "mesh": 1 },
{ "camera": 1, "matrix": [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 5, 0, 7, 1],
"extensions": { "KHR_lights_punctual": { "light": 1 } } }],
"cameras": [{ "type": "perspective", "perspective": { "yfov": 0.7, "znear": 0.1, "aspectRatio": 1.5 } },
{ "type": "perspective", "perspective": { "yfov": 0.5, "znear": 0.01, "zfar": 100 } }],
"images": [{ "uri": "t.png" }], "samplers": [{ "wrapS": 33071, "magFilter": 9728 }],
"textures": [{ "source": 0, "sampler": 0 }],
"materials": [{ "pbrMetallicRoughness": { "baseColorTexture": { "index": 0 }, "metallicFactor": 0.5 },
"normalTexture": { "index": 0 }, "alphaMode": "MASK", "alphaCutoff": 0.4 },
{ "doubleSided": true, "emissiveFactor": [1, 1, 0],
"extensions": { "KHR_materials_transmission": { "transmissionFactor": 0.75 } } }],
"meshes": [{ "primitives": [{ "attributes": { "POSITION": 0, "TEXCOORD_0": 1 }, "indices": 3, "material": 0 }] },
{ "primitives": [{ "attributes": { "POSITION": 0 }, "mode": 5, "material": 1 }], "weights": [] }],
"accessors": [{ "bufferView": 0, "componentType": 5126, "count": 4, "type": "VEC3" },
{ "bufferView": 1, "componentType": 5126, "count": 4, "type": "VEC2" },
{ "bufferView": 0, "componentType": 5126, "count": 3, "type": "VEC3", "normalized": false },
{ "bufferView": 2, "componentType": 5121, "count": 6, "type": "SCALAR" }],
"bufferViews": [{ "buffer": 0, "byteOffset": 0, "byteLength": 48 }, { "buffer": 0, "byteOffset": 48, "byteLength": 32 },
{ "buffer": 0, "byteOffset": 80, "byteLength": 6 }],
"buffers": [{ "byteLength": 88, "uri": "m.bin" }, { "byteLength": 88, "uri": "%6d.bin" }],
"animations": [{ "channels": [], "samplers": [] }] }
"#;

/// The words of a grammar: names of what it has, for places where others stand.
const MITSUBA_WORDS: &str = "scene integrator sensor sampler film rfilter bsdf shape emitter texture medium phase \
    volume spectrum default include path alias ref id as name value filename type version transform translate rotate \
    scale lookat matrix point vector float integer boolean string rgb srgb x y z origin target up angle volpath direct \
    aov prb ptracer hide_emitters max_depth perspective thinlens orthographic fov fov_axis focal_length near_clip \
    far_clip hdrfilm ldrfilm width height crop_width diffuse conductor roughconductor dielectric roughdielectric \
    thindielectric plastic roughplastic principled mask blendbsdf normalmap bumpmap twosided null reflectance \
    specular_reflectance alpha alpha_u alpha_v distribution ggx beckmann eta k material int_ior ext_ior nonlinear \
    opacity weight base_color roughness metallic spec_trans clearcoat flip_invalid_normals use_shadowing_function \
    obj ply serialized rectangle cube disk sphere cylinder shapegroup instance merge to_world flip_normals \
    face_normals shape_index center radius p0 p1 area constant envmap spot directional radiance intensity irradiance \
    cutoff_angle beam_width bitmap checkerboard mesh_attribute vertex_color to_uv raw wrap_mode clamp filter_type d65 \
    uniform blackbody temperature color #ff8000 400:1,700:2 $depth $file xmlns:a";
const PBRT_WORDS: &str = "LookAt Camera Film Integrator Sampler PixelFilter Accelerator ColorSpace Option WorldBegin \
    AttributeBegin AttributeEnd TransformBegin TransformEnd Attribute ObjectBegin ObjectEnd ObjectInstance Identity \
    Translate Scale Rotate Transform ConcatTransform CoordinateSystem CoordSysTransform ReverseOrientation \
    ActiveTransform Include Import LightSource AreaLightSource Material MakeNamedMaterial NamedMaterial Texture Shape \
    MediumInterface MakeNamedMedium float integer bool string rgb spectrum blackbody texture point2 point3 vector3 \
    normal perspective orthographic spherical lensradius screenwindow frameaspectratio shutteropen rgb gbuffer iso \
    sensor path volpath bdpt maxdepth regularize infinite distant point spot goniometric illuminance power scale from \
    to diffuse conductor dielectric thindielectric coateddiffuse coatedconductor mix hair interface measured \
    reflectance roughness uroughness vroughness remaproughness eta k metal-Au-eta glass-BK7 normalmap displacement \
    constant imagemap checkerboard fbm wrinkled tex tex1 tex2 amount encoding wrap filter invert mapping uscale vdelta \
    trianglemesh plymesh bilinearmesh sphere disk cylinder curve loopsubdiv P N uv indices alpha radius zmin zmax \
    phimax innerradius height twosided L I srgb rec2020 dci-p3 seed matte image 02sequence WorldEnd";
const JSON_WORDS: &str = "asset version scene scenes nodes mesh camera children translation rotation scale matrix \
    meshes primitives attributes POSITION NORMAL TANGENT TEXCOORD_0 COLOR_0 JOINTS_0 WEIGHTS_0 TRANSLATION ROTATION \
    SCALE indices material mode targets weights skins joints inverseBindMatrices cameras perspective orthographic yfov \
    znear aspectRatio materials pbrMetallicRoughness baseColorTexture baseColorFactor metallicFactor normalTexture \
    emissiveFactor alphaMode MASK BLEND OPAQUE alphaCutoff doubleSided textures source sampler images uri bufferView \
    mimeType accessors componentType count type SCALAR VEC2 VEC3 VEC4 MAT4 sparse normalized byteOffset byteStride \
    bufferViews buffers byteLength extensions extensionsUsed extensionsRequired KHR_lights_punctual lights light spot \
    directional intensity range EXT_mesh_gpu_instancing KHR_materials_volume KHR_texture_transform \
    KHR_draco_mesh_compression KHR_animation_pointer 5120 5121 5123 5125 5126 data:;base64,AAAA m.bin seed origin \
    target up fov_x near max_depth shapes geometry rectangle disk cube center radius to_world emission flip_normals \
    diffuse conductor dielectric thin_dielectric plastic principled mask blend two_sided normal_map relief finish \
    reflectance opacity inner a b alpha eta k int_ior ext_ior constant bitmap checkerboard vertex_color product value \
    image uv channel clamp emitters envmap point radiance hide_emitters null true false";

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

/// A text in which a few words are others, of this grammar or of [`WORDS`], or lines are lost, repeated or moved.
fn mangle_text(sound: &str, grammar: &[&str], draw: &mut Stream) -> String {
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
        let word = match draw.below(3) {
            0 => own.as_str(),
            1 => grammar[draw.below(grammar.len())],
            _ => WORDS[draw.below(WORDS.len())],
        };
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

/// Turns that a busy machine takes, too: enough for scenes of each format to be read, and to be refused.
const LEAST_TURNS: u64 = 120;

/// The words of the grammar of a file.
fn grammar(name: &str) -> Vec<&'static str> {
    let words = match name.rsplit('.').next() {
        Some("xml") => MITSUBA_WORDS,
        Some("pbrt") => PBRT_WORDS,
        _ => JSON_WORDS,
    };
    words.split_ascii_whitespace().collect()
}

/// Our own scene of a mesh and a picture, with these.
fn described(picture: &Image) -> Vec<(String, Vec<u8>)> {
    let mesh = Mesh {
        positions: vec![[0.0; 3], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]],
        triangles: vec![[0, 1, 2]],
        uvs: Some(vec![[0.0; 2], [1.0, 0.0], [0.0, 1.0]]),
        ..Mesh::default()
    };
    let blobs = [mesh.to_bytes().expect("a small mesh"), picture.to_bytes()];
    let [mesh, image] = [&blobs[0], &blobs[1]].map(|bytes| Digest::of(bytes));
    let one = json!({ "type": "constant", "value": [1, 1, 1] });
    let texture = json!({ "type": "bitmap", "image": image, "uv": [[1, 0, 0], [0, 1, 0]], "scale": [1, 1, 1] });
    let glass = json!({ "type": "dielectric", "int_ior": 1.5, "ext_ior": 1, "alpha": 0.1, "specular_reflectance": one,
        "specular_transmittance": one });
    let paint = json!({ "type": "two_sided", "inner": { "type": "diffuse", "reflectance": texture } });
    let blend = json!({ "type": "blend", "weight": one, "a": paint, "b": glass });
    let stands = [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0]];
    let scene = json!({
        "version": 1, "seed": 7, "max_depth": 6,
        "camera": { "origin": [0, 0, 4], "target": [0, 0, 0], "up": [0, 1, 0], "fov_x": 40, "near": 0.1 },
        "shapes": [{ "geometry": { "type": "mesh", "mesh": mesh }, "material": 0, "to_world": stands },
            { "geometry": { "type": "sphere", "center": [0, 1, 0], "radius": 0.5 }, "material": 1, "to_world": stands,
              "emission": one, "flip_normals": true }],
        "materials": [{ "type": "mask", "opacity": one, "inner": paint }, blend],
        "emitters": [{ "type": "envmap", "image": image, "scale": 2, "to_world": stands },
            { "type": "point", "position": [0, 5, 0], "intensity": [1, 2, 3] }],
    });
    let text = serde_json::to_vec_pretty(&scene).expect("plain data");
    let blobs = blobs.into_iter().map(|bytes| (format!("blob/{}", Digest::of(&bytes)), bytes));
    std::iter::once(("scene.json".to_owned(), text)).chain(blobs).collect()
}

/// Sound scenes: files by name, the scene's own first.
fn scenes() -> Vec<Vec<(String, Vec<u8>)>> {
    let mut picture = Image::new(4, 4, 3);
    picture.data_mut().iter_mut().enumerate().for_each(|(i, v)| *v = i as f32 / 48.0);
    let png = encode_png(&picture).expect("a picture");
    let sky = b"#?RGBE\n\n-Y 1 +X 2\n\x80\x40\x20\x81\x80\x80\x80\x80".to_vec();
    let packed = MITSUBA.replace("m.obj", "m.serialized").replace("\"obj\"", "\"serialized\"");
    let text = |text: &str| text.as_bytes().to_vec();
    let corners = [0.0f32, 0.0, 0.0, 1.0, 0.0, 0.0, 1.0, 1.0, 0.0, 0.0, 1.0, 0.5];
    let uvs = [0.0f32, 0.0, 1.0, 0.0, 1.0, 1.0, 0.0, 1.0];
    let mut buffer: Vec<u8> = corners.iter().chain(&uvs).flat_map(|v| v.to_le_bytes()).collect();
    buffer.extend([0, 1, 2, 0, 2, 3, 0, 0]);
    let named = vec![
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
        vec![
            ("a.pbrt", text(PBRT)),
            ("more.pbrt", text("Shape \"sphere\"\n")),
            ("m.ply", text(PLY)),
            ("t.png", png.clone()),
        ],
        vec![("a.gltf", text(GLTF)), ("m.bin", buffer), ("t.png", png)],
    ];
    let owned = |files: Vec<(&str, Vec<u8>)>| files.into_iter().map(|(name, bytes)| (name.to_owned(), bytes)).collect();
    named.into_iter().map(owned).chain([described(&picture)]).collect()
}

#[test]
#[expect(clippy::disallowed_methods, reason = "it looks for a time, and for how long single scenes take")]
fn fuzz_scenes() {
    let env = |name: &str| std::env::var(name).ok().and_then(|text| text.parse::<f64>().ok());
    let seconds = env("TAUFLOW_FUZZ_SECONDS").unwrap_or(3.0);
    let scenes = scenes();
    let mut draw = Stream::new(env("TAUFLOW_FUZZ_SEED").unwrap_or(1.0) as u64, &[0x5CE]);
    let place = folder("fuzz_scenes");
    fs::create_dir_all(place.join("blob")).expect("writable");
    let begun = Instant::now();
    let mut counts: BTreeMap<&str, [u64; 2]> = BTreeMap::new();
    let (mut slowest, mut largest) = (Duration::ZERO, 0);
    for turn in 0u64.. {
        if begun.elapsed().as_secs_f64() >= seconds && turn >= LEAST_TURNS {
            break;
        }
        let scene = &scenes[draw.below(scenes.len())];
        // The first turns read each scene as it is, and some turns damage what a scene names.
        let damaged = if draw.chance(0.7) { 0 } else { draw.below(scene.len()) };
        let scene = if turn < scenes.len() as u64 { &scenes[turn as usize] } else { scene };
        for (index, (name, sound)) in scene.iter().enumerate() {
            let bytes = match (index == damaged && turn >= scenes.len() as u64, std::str::from_utf8(sound)) {
                (true, Ok(text)) if draw.chance(0.8) => mangle_text(text, &grammar(name), &mut draw).into_bytes(),
                (true, _) => mangle_bytes(sound, &scene[draw.below(scene.len())].1, &mut draw),
                (false, _) => sound.clone(),
            };
            fs::write(place.join(name), bytes).expect("writable");
        }
        let own = scene[0].0.as_str();
        let options = Options { approximate: true, ..Options::default() };
        let path = place.join(own);
        let view = if turn < scenes.len() as u64 { 0 } else { draw.below(2) };
        let load = || catch_unwind(AssertUnwindSafe(|| load_scene(&path, None, view, options)));
        let ((done, held), took) = timed(|| held_by(load));
        let told = |what: String| -> ! {
            let kept = folder("fuzz_scenes_failed");
            fs::create_dir_all(kept.join("blob")).expect("writable");
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
                    let named = scene.iter().any(|(name, _)| line.starts_with(name.as_str()));
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
