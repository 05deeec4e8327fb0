//! The page in headless Chromium: its pixels, its layout, its controls, and what it says of damage.

use base64::{Engine as _, engine::general_purpose::STANDARD};
use half::f16;
use serde_json::{Value, json};
use std::{collections::BTreeMap, fs, path::Path};
use tauflow_data::{Image, image_io::parse_exr};
use tauflow_testing::Browser;
use tauflow_viewer::{Content, Frame, Half, Head, Page, Scene, Track, Written};

const WIDTH: usize = 40;
const HEIGHT: usize = 30;

/// An image whose pixels are `of(x, y, channel)`.
fn image(of: impl Fn(usize, usize, usize) -> f32) -> Image {
    let pixels = (0..HEIGHT).flat_map(|y| (0..WIDTH).map(move |x| (x, y)));
    let data = pixels.flat_map(|(x, y)| [of(x, y, 0), of(x, y, 1), of(x, y, 2)]).collect();
    Image::from_data(WIDTH, HEIGHT, 3, data).expect("as many")
}

fn noisy() -> Image {
    image(|x, y, k| ((x * 7 + y * 13 + k * 5) % 17) as f32 / 16.0)
}

fn clean() -> Image {
    image(|x, y, k| ((x / 5 * 5 + y / 6 * 11 + k * 3) % 17) as f32 / 16.0)
}

/// Values of many magnitudes, beyond half floats, and not finite.
fn wild() -> Image {
    image(|x, y, k| match (x, y) {
        (0, 0) => f32::NAN,
        (1, 0) => f32::INFINITY,
        (2, 0) => 1e6,
        _ => ((x * 31 + y * 17 + k * 7) as f32 * 0.37).sin().abs() * 10f32.powi((x % 9) as i32 - 5),
    })
}

fn frames() -> (Vec<Frame>, Vec<Track>) {
    let track =
        |name: &str| Track { name: name.into(), space: "exposed linear radiance".into(), raw: false, between: None };
    let frame = |track, label: &str, content, order, tau| {
        let id = format!("{track}/{label}");
        Frame { id, track, label: label.into(), content, order, tau, before: None }
    };
    let rungs = [(1, 0.0), (2, 0.4), (16, 1.0)];
    let mut frames: Vec<Frame> =
        rungs.map(|(spp, tau)| frame(0, &format!("{spp} spp"), Content::Radiance, spp, Some(tau))).into();
    frames.push(frame(1, "NFE 1", Content::Radiance, 1, Some(1.0)));
    frames.push(frame(2, "normal", Content::Normal, 0, None));
    // A solver that went from the first rung to the last in two calls.
    for (call, tau) in [(1, 0.6), (2, 1.0)] {
        frames.push(frame(3, &format!("call {call} of 2"), Content::Radiance, call, Some(tau)));
    }
    frames.push(frame(4, "adapted", Content::Display, 0, None));
    for (frame, before) in [(1, 0), (2, 1), (3, 0), (5, 0), (6, 5)] {
        frames[frame].before = Some(before);
    }
    let mut tracks: Vec<Track> =
        ["rungs", "refined: mc_noise", "G-buffer", "states of NFE 2", "samples"].map(track).into();
    tracks[3].between = Some(0);
    (frames, tracks)
}

/// Writes a page of so many scenes; small ones have one image.
fn written(path: &Path, scenes: usize, limit: Option<usize>, small: bool) -> Written {
    let (frames, tracks) = frames();
    let mut page = Page::new(path, limit);
    for number in 0..scenes {
        let mut images = vec![(0, noisy()), (1, wild()), (2, clean()), (3, clean().map(|v| v * 0.5)), (4, noisy())];
        let half = |a: Image, b: Image| image(|x, y, k| 0.5 * (a.pixel(x, y)[k] + b.pixel(x, y)[k]));
        images.extend([(5, half(noisy(), clean())), (6, clean()), (7, clean().map(|v| v.min(1.0)))]);
        if small {
            let tiny = |v: usize| Image::from_data(1, 1, 3, vec![v as f32 / 4096.0; 3]).expect("fits");
            images = vec![(0, tiny(number)), (2, tiny(0))];
        }
        let scene = Scene {
            key: format!("{}-{number:06}", ["rooms </script>", "halls"][number % 2]),
            stratum: ["rooms </script>", "halls"][number % 2].into(),
            reasons: Some(if number % 3 == 1 { vec!["dark".into()] } else { vec![] }),
            measures: BTreeMap::from([("contrast".to_owned(), number as f64)]),
            exposure: Some(2.0),
            reference: Some(2),
            images,
        };
        page.add(scene, &frames, &tracks).expect("it can be written");
    }
    let head = Head {
        title: "a <b>test</b>".into(),
        provenance: "tauflow. Made by:".into(),
        command: "tauflow view a.yaml b".into(),
        first: 0,
        reasons: BTreeMap::from([("dark".to_owned(), "most of it is black".to_owned())]),
    };
    page.finish(&head, &frames, &tracks).expect("it can be written")
}

fn opened(browser: &mut Browser, page: &Path, width: u32) {
    browser.size(width, 800);
    browser.open(page);
    browser.wait("now.a !== null");
}

fn calm(browser: &Browser) {
    assert!(browser.problems().is_empty(), "{:#?}", browser.problems());
}

#[test]
fn pixels_on_the_graphics_processor_and_in_the_download_are_those_of_the_image() {
    let Some(mut browser) = Browser::start("pixels of the viewer") else { return };
    let folder = tempfile::tempdir().expect("temporary files");
    let page = folder.path().join("page.html");
    written(&page, 1, None, false);
    opened(&mut browser, &page, 1400);
    for (frame, image) in [(0, noisy()), (1, wild()), (2, clean())] {
        browser.eval(&format!("choose('a', {frame})"));
        browser.wait(&format!("now.a.frame === {frame}"));
        let read = browser.eval("Array.from(canvas.readBack(now.a), String)");
        let read: Vec<f32> = read.as_array().expect("a list").iter().map(|v| number(v.as_str())).collect();
        let half = Half::of(&image);
        assert_eq!(browser.eval("now.a.clipped"), json!(half.clipped));
        let stated = browser.eval("now.a.error[0]").as_f64().expect("a number");
        assert!(stated >= half.absolute && stated <= half.absolute * 1.001, "{stated} for {}", half.absolute);
        for (at, wanted) in image.data().iter().copied().enumerate() {
            // The texture has an alpha channel, too.
            let found = read[at / 3 * 4 + at % 3];
            let bits = f16::from_bits(half.bits[at]).to_f32();
            assert!(
                found.to_bits() == bits.to_bits() || (found.is_nan() && bits.is_nan()),
                "{frame} {at}: {found}, not {bits}"
            );
            let clipped = wanted.is_finite() && wanted > tauflow_viewer::LARGEST;
            let error = f64::from(found) - f64::from(wanted);
            assert!(!wanted.is_finite() || clipped || error.abs() <= stated, "{wanted} as {found}");
        }
        // The file that the link gives.
        let script = "(() => { let s = ''; for (const b of new Uint8Array(exrFile(now.a))) \
                      s += String.fromCharCode(b); \
                      return btoa(s); })()";
        let bytes = STANDARD.decode(browser.eval(script).as_str().expect("a text")).expect("base64");
        let layers = parse_exr("viewer.exr", &bytes).expect("an EXR file");
        let exr = &layers[""];
        assert_eq!((exr.width(), exr.height()), (WIDTH, HEIGHT));
        let same = |(a, b): (&f32, &u16)| {
            let b = f16::from_bits(*b).to_f32();
            *a == b || (a.is_nan() && b.is_nan())
        };
        assert!(exr.data().iter().zip(&half.bits).all(same));
    }
    calm(&browser);
}

#[test]
fn states_of_a_solver_stand_between_the_rungs_and_have_directions() {
    let Some(mut browser) = Browser::start("states of the viewer") else { return };
    let folder = tempfile::tempdir().expect("temporary files");
    let page = folder.path().join("page.html");
    written(&page, 1, None, false);
    opened(&mut browser, &page, 1400);
    assert_eq!(browser.eval("document.querySelectorAll('#rail .own').length"), json!(0), "rungs alone");
    browser.eval("choose('a', 5)");
    browser.wait("now.a.frame === 5");
    // The rail: two rungs, and the solver's states at their times. The last rung is where the last state is.
    let stops = "[...document.querySelectorAll('#rail .stop')].map((e) => [e.className, e.title.split(',')[1]])";
    let own = json!([
        ["stop rung", " 1 spp"],
        ["stop rung", " 2 spp"],
        ["stop own", " call 1 of 2"],
        ["stop own", " call 2 of 2"]
    ]);
    assert_eq!(browser.eval(stops), own);
    assert!(browser.eval("$('tracks').textContent").as_str().is_some_and(|text| text.contains("not renders")));
    // A direction is the signed difference to the state before: of the first state, to the rung that it came from.
    browser.key("5");
    browser.wait("state.mode === 'direction' && now.error !== null && now.b !== null && now.b.frame === 0");
    browser.wait("$('tag-a').textContent === 'Direction to states of NFE 2, call 1 of 2'");
    assert_eq!(browser.eval("$('tag-b').textContent"), json!("from rungs, 1 spp"));
    let found = browser.eval("errorAt(7 * 40 + 11)").as_f64().expect("a number");
    let luma = |of: Image| -> f64 {
        let pixel = of.pixel(11, 7);
        [0.2126, 0.7152, 0.0722].iter().zip(pixel).map(|(weight, v)| weight * f64::from(*v)).sum()
    };
    let wanted = 0.5 * (luma(clean()) - luma(noisy()));
    assert!(wanted.abs() > 0.01 && (found - wanted).abs() < 1e-3, "{found}, not {wanted}");
    // The bar has the range on both sides.
    let ends = browser.eval("[...$('bar').querySelectorAll('span')].map((e) => e.textContent)");
    let end = |at: usize| ends[at].as_str().and_then(|text| text.parse::<f64>().ok()).expect("a number");
    assert!(end(2) > 0.0 && end(0) == -end(2) && ends[1] == json!("Signed difference"), "{ends}");
    browser.key("ArrowRight");
    browser.wait("now.a.frame === 6 && now.b !== null && now.b.frame === 5");
    // The first rung has nothing before it, and the other modes keep their own B.
    browser.eval("choose('a', 0)");
    browser.wait("now.a.frame === 0 && now.b === null && !$('message').hidden");
    browser.key("4");
    browser.wait("state.mode === 'error' && now.b !== null && now.b.frame === 2 && $('message').hidden");
    calm(&browser);
}

fn number(text: Option<&str>) -> f32 {
    let text = text.expect("a text");
    text.replace("Infinity", "inf").parse().expect("a number")
}

#[test]
fn flip_is_that_of_its_reference_implementation() {
    let Some(mut browser) = Browser::start("FLIP of the viewer") else { return };
    let folder = tempfile::tempdir().expect("temporary files");
    let page = folder.path().join("page.html");
    written(&page, 1, None, false);
    opened(&mut browser, &page, 1400);
    browser.eval("setMeasure('flip')");
    browser.wait("now.error !== null && state.mode === 'error'");
    let at = |x: usize, y: usize| format!("now.error.map[{}]", y * WIDTH + x);
    // flip_evaluator 1.7 of `clean` and `noisy`, LDR, inputsRGB=False.
    let expected =
        [((0, 0), 0.701_560), ((10, 5), 0.605_962), ((39, 29), 0.973_534), ((20, 15), 0.621_757), ((3, 28), 0.737_012)];
    for ((x, y), value) in expected {
        let found = browser.eval(&at(x, y)).as_f64().expect("a number");
        assert!((found - value).abs() < 2e-6, "({x}, {y}): {found}, not {value}");
    }
    let mean = browser.eval("now.error.map.reduce((s, v) => s + v, 0) / now.error.map.length").as_f64();
    assert!((mean.expect("a number") - 0.714_194).abs() < 2e-6, "{mean:?}");
    calm(&browser);
}

#[test]
fn the_shader_shows_what_the_script_computes() {
    let Some(mut browser) = Browser::start("the viewer's shader") else { return };
    let folder = tempfile::tempdir().expect("temporary files");
    let page = folder.path().join("page.html");
    written(&page, 1, None, false);
    opened(&mut browser, &page, 1400);
    browser.eval("choose('b', 2)");
    browser.wait("now.b !== null && now.b.frame === 2");
    // The middle of pixel (11, 7), in bytes of the canvas.
    let seen = "(() => { canvas.textures.clear(); paint(); const g = canvas.gl, out = new Uint8Array(4); \
                const at = (k) => Math.floor((k ? state.y : state.x) + (k ? 7.5 : 11.5) * state.scale); \
                g.readPixels(at(0), canvas.element.height - 1 - at(1), 1, 1, g.RGBA, g.UNSIGNED_BYTE, out); \
                return Array.from(out); })()";
    let bytes = |value: &Value| -> Vec<f64> {
        value.as_array().expect("a list").iter().take(3).map(|v| v.as_f64().expect("a number")).collect()
    };
    let close = |found: Vec<f64>, wanted: Vec<f64>, what: &str| {
        assert!(found.iter().zip(&wanted).all(|(a, b)| (a - b).abs() <= 1.5), "{what}: {found:?}, not {wanted:?}");
    };
    browser.eval("setMode('single')");
    for (tone, ev) in [(0, 0.0), (0, 1.5), (1, 1.0), (2, -1.0), (3, 0.5)] {
        browser.eval(&format!("state.tone = {tone}; setExposure({ev})"));
        let own = browser.eval(
            "shown([0, 1, 2].map((k) => valueOf(now.a, 7 * 40 + 11, k)), gain(), state.tone).map((v) => 255 * v)",
        );
        close(bytes(&browser.eval(seen)), bytes(&own), &format!("tone {tone}, {ev} EV"));
    }
    // Display values are shown as they are, and exposed in linear light.
    browser.eval("state.tone = 0; setExposure(0); choose('a', 7)");
    browser.wait("now.a.frame === 7");
    let value = browser.eval("[0, 1, 2].map((k) => 255 * valueOf(now.a, 7 * 40 + 11, k))");
    close(bytes(&browser.eval(seen)), bytes(&value), "display values");
    browser.eval("setExposure(-1)");
    let half = browser.eval("[0, 1, 2].map((k) => 255 * srgb(0.5 * unsrgb(valueOf(now.a, 7 * 40 + 11, k))))");
    assert_ne!(bytes(&value), bytes(&half));
    close(bytes(&browser.eval(seen)), bytes(&half), "display values at half exposure");
    browser.eval("choose('a', 0)");
    browser.wait("now.a.frame === 0");
    for measure in ["squared", "relative", "absolute", "signed", "flip"] {
        browser.eval(&format!("state.tone = 0; setMeasure('{measure}'); setExposure(0)"));
        let own = browser.eval(
            "(() => { const v = errorAt(7 * 40 + 11), r = state.range; \
             const t = state.measure === 'signed' ? 0.5 + 0.5 * v / r : v / r; \
             const ramp = RAMPS[state.measure === 'signed' ? 'signed' : 'magma']; \
             const i = 4 * Math.round(255 * Math.min(1, Math.max(0, t))); \
             return [ramp[i], ramp[i + 1], ramp[i + 2]]; })()",
        );
        let (found, wanted) = (bytes(&browser.eval(seen)), bytes(&own));
        // One entry of the colour map apart, by rounding.
        assert!(found.iter().zip(&wanted).all(|(a, b)| (a - b).abs() <= 4.0), "{measure}: {found:?}, not {wanted:?}");
    }
    calm(&browser);
}

/// Whether anything in sight is wider than the window, or cut off by an element that does not scroll.
const OVERFLOW: &str = "(() => { const w = document.documentElement.clientWidth; \
    const bad = [...document.querySelectorAll('#app *')].filter((e) => { const r = e.getBoundingClientRect(); \
    const hidden = !e.checkVisibility() || e.closest('#rows,#over,.tag,.stop'); \
    return !hidden && (r.right > w + 1 || r.left < -1); }).map((e) => e.tagName + '#' + e.id); \
    if (document.documentElement.scrollWidth > w) bad.push('page'); return bad; })()";

/// Pairs of text and background with too little contrast, by WCAG AA.
const CONTRAST: &str = "(() => { const parse = (c) => (c.match(/[\\d.]+/g) || []).map(Number); \
    const lum = (c) => { const [r, g, b] = c.slice(0, 3).map((v) => unsrgb(v / 255)); \
    return 0.2126 * r + 0.7152 * g + 0.0722 * b; }; \
    const back = (e) => { for (; e; e = e.parentElement) { const c = parse(getComputedStyle(e).backgroundColor); \
    if (c.length === 3 || c[3] > 0.5) return c; } return [255, 255, 255]; }; const bad = []; \
    for (const e of document.querySelectorAll('#app *')) { \
    const text = [...e.childNodes].some((n) => n.nodeType === 3 && n.data.trim()); \
    if (!e.checkVisibility() || e.disabled || !text) continue; \
    const style = getComputedStyle(e), a = lum(parse(style.color)), b = lum(back(e.closest('.rail') || e)); \
    const ratio = (Math.max(a, b) + 0.05) / (Math.min(a, b) + 0.05); \
    if (ratio < 4.5) bad.push(`${e.tagName}#${e.id}.${e.className} ${ratio.toFixed(2)}`); \
    if (parseFloat(style.fontSize) < 10) bad.push(`${e.tagName}#${e.id} ${style.fontSize}`); } return bad; })()";

#[test]
fn nothing_overflows_and_all_text_can_be_read() {
    let Some(mut browser) = Browser::start("widths of the viewer") else { return };
    let folder = tempfile::tempdir().expect("temporary files");
    let page = folder.path().join("page.html");
    written(&page, 5, None, false);
    for width in [400, 900, 1400] {
        opened(&mut browser, &page, width);
        for mode in ["single", "wipe", "flip", "error", "direction"] {
            browser.eval(&format!("setMode('{mode}')"));
            assert_eq!(browser.eval(OVERFLOW), json!([]), "{mode} at {width}");
            assert_eq!(browser.eval(CONTRAST), json!([]), "{mode} at {width}");
        }
        // The canvas keeps its share of the window.
        let share = browser.eval("$('view').clientHeight / innerHeight").as_f64().expect("a number");
        assert!(share > 0.4, "{share} at {width}");
        for drawer in ["scenes", "side"] {
            let clicked = browser.eval(&format!(
                "(() => {{ const b = document.querySelector('[data-drawer={drawer}]'); \
                 if (!b.checkVisibility()) return false; b.click(); return true; }})()"
            ));
            assert_eq!(browser.eval(&format!("$('{drawer}').checkVisibility()")), json!(true), "{width} {clicked}");
            assert_eq!(browser.eval(OVERFLOW), json!([]), "{drawer} at {width}");
            assert_eq!(browser.eval(CONTRAST), json!([]), "{drawer} at {width}");
            browser.eval("closeDrawers()");
        }
    }
    calm(&browser);
}

#[test]
fn keys_and_fingers_work() {
    let Some(mut browser) = Browser::start("controls of the viewer") else { return };
    let folder = tempfile::tempdir().expect("temporary files");
    let page = folder.path().join("page.html");
    written(&page, 5, None, false);
    opened(&mut browser, &page, 1400);
    // Along the rungs, real states alone; to another track; to another scene.
    browser.key("ArrowRight");
    browser.wait("now.a.frame === 1");
    browser.key("ArrowRight");
    browser.wait("now.a.frame === 2");
    browser.key("ArrowRight");
    browser.key("ArrowDown");
    browser.wait("now.a.frame === 3");
    browser.key("]");
    browser.wait("state.scene !== 0 && now.a !== null && now.a.id.startsWith(`${state.scene}/`)");
    browser.key("e");
    assert_eq!(browser.eval("state.ev"), json!(0.5));
    browser.key("4");
    browser.wait("state.mode === 'error' && now.error !== null");
    browser.key("+");
    assert_eq!(browser.eval("state.fitted"), json!(false));
    browser.key("f");
    // The state is in the address.
    let hash = browser.eval("location.hash");
    assert!(hash.as_str().is_some_and(|hash| hash.contains("mode=error") && hash.contains("ev=0.5")), "{hash}");
    // It opens with the image beside its reference. Two fingers zoom, one moves.
    opened(&mut browser, &page, 400);
    assert_eq!(browser.eval("[state.mode, now.b.frame]"), json!(["wipe", 2]));
    browser.eval("setMode('single')");
    let scale = browser.eval("state.scale").as_f64().expect("a number");
    let at = |v: &Value| v.as_f64().expect("a number");
    let middle = browser.eval(
        "(() => { const r = $('view').getBoundingClientRect(); return [r.x + r.width / 2, r.y + r.height / 2]; })()",
    );
    let (x, y) = (at(&middle[0]), at(&middle[1]));
    browser.touch(&[[x - 30.0, y], [x + 30.0, y]], &[[x - 90.0, y], [x + 90.0, y]]);
    let zoomed = browser.eval("state.scale").as_f64().expect("a number");
    assert!((zoomed / scale - 3.0).abs() < 0.05, "{scale} -> {zoomed}");
    let before = browser.eval("state.x").as_f64().expect("a number");
    browser.touch(&[[x, y]], &[[x + 40.0, y]]);
    let after = browser.eval("state.x").as_f64().expect("a number");
    assert!((after - before - 40.0).abs() < 1.0, "{before} -> {after}");
    calm(&browser);
}

#[test]
fn scenes_are_found_by_stratum_verdict_and_value() {
    let Some(mut browser) = Browser::start("scenes of the viewer") else { return };
    let folder = tempfile::tempdir().expect("temporary files");
    let page = folder.path().join("page.html");
    let written = written(&page, 4000, Some(0), true);
    assert_eq!(written.folder, Some(folder.path().join("page_files")));
    opened(&mut browser, &page, 1400);
    // At the start, one scene and the thumbnails in sight are read, of 4,063 files.
    browser.wait("$('rows').querySelector('canvas').width !== 48");
    assert_eq!(browser.eval("[kept.size, thumbs.size]"), json!([1, 1]));
    let count = "$('count').textContent";
    assert_eq!(browser.eval(count), json!("4000 scenes"));
    // Rows are made as they are seen.
    browser.wait("$('rows').children.length > 5 && $('rows').children.length < 40");
    let pick = |browser: &mut Browser, id: &str, value: &str| {
        browser.eval(&format!("$('{id}').value = '{value}'; $('{id}').dispatchEvent(new Event('input'))"));
        browser.eval(count).as_str().expect("a text").to_owned()
    };
    assert_eq!(pick(&mut browser, "stratum", "halls"), "2000 of 4000 scenes");
    assert_eq!(pick(&mut browser, "verdict", "-"), "667 of 4000 scenes");
    assert_eq!(pick(&mut browser, "verdict", "dark"), "667 of 4000 scenes");
    assert_eq!(pick(&mut browser, "verdict", ""), "2000 of 4000 scenes");
    assert_eq!(pick(&mut browser, "search", "000101"), "1 of 4000 scenes");
    pick(&mut browser, "search", "");
    pick(&mut browser, "stratum", "");
    let order = browser.eval("String(ORDERS.findIndex(([label]) => label === 'Gate: contrast'))");
    pick(&mut browser, "sort", order.as_str().expect("a number"));
    browser.eval("$('rows').firstChild.click()");
    browser.wait("state.scene === 3999 && now.data !== null && now.data.number === 3999");
    // Names are an order of their own where scenes are listed otherwise.
    let found = browser.eval("orders().slice(0, 2).map(([label, places]) => [label, places === null])");
    assert_eq!(found, json!([["As listed", true], ["Name", false]]));
    pick(&mut browser, "sort", "1");
    let sorted = "listed.map((i) => index.scenes[i].key).every((key, i, all) => !i || all[i - 1] < key)";
    assert_eq!(browser.eval(sorted), json!(true));
    calm(&browser);
}

#[test]
fn the_sample_of_the_documentation_opens() {
    let Some(mut browser) = Browser::start("sample of the viewer") else { return };
    let page = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../docs/sample/viewer.html");
    for width in [400, 900, 1400] {
        opened(&mut browser, &page, width);
        assert!(browser.eval("index.scenes.length").as_u64() > Some(2), "it has scenes");
        for mode in ["single", "wipe", "error"] {
            browser.eval(&format!("setMode('{mode}')"));
            assert_eq!(browser.eval(OVERFLOW), json!([]), "{mode} at {width}");
        }
        assert!(browser.eval("framesOf(0).length").as_u64() > Some(1), "it has rungs");
    }
    calm(&browser);
}

#[test]
fn damage_is_told() {
    let Some(mut browser) = Browser::start("damage of the viewer") else { return };
    let folder = tempfile::tempdir().expect("temporary files");
    let page = folder.path().join("page.html");
    written(&page, 3, Some(0), false);
    fs::remove_file(folder.path().join("page_files/s000001.js")).expect("it was there");
    let damaged = folder.path().join("page_files/s000002.js");
    let text = fs::read_to_string(&damaged).expect("it is there");
    // Other bytes that are base64, too.
    let place = text.find("\"d\":\"").expect("data") + 100;
    fs::write(&damaged, format!("{}AAAA{}", &text[..place], &text[place + 4..])).expect("it can be written");
    opened(&mut browser, &page, 900);
    let told = "$('message').hidden ? '' : $('message').textContent";
    browser.eval("await goTo(1)");
    let message = browser.eval(told).as_str().expect("a text").to_owned();
    assert!(message.contains("page_files/s000001.js is missing; make this page again: tauflow view"), "{message}");
    // Nothing of the scene before is left.
    let name = browser.eval("index.scenes[1].key").as_str().expect("a text").to_owned();
    assert!(browser.eval("$('title').textContent").as_str().is_some_and(|title| title.starts_with(&name)));
    assert!(browser.eval("location.hash").as_str().is_some_and(|hash| hash.contains(&name)));
    assert_eq!(
        browser.eval("[$('facts').children.length, $('error-box').hidden, $('rail').children.length]"),
        json!([0, true, 0])
    );
    browser.eval("await goTo(2)");
    let message = browser.eval(told).as_str().expect("a text").to_owned();
    assert!(message.contains("000002, ") && message.contains("its data is damaged; make"), "{message}");
    browser.forgive();
    // What is there still shows.
    browser.eval("await goTo(0)");
    assert_eq!(browser.eval("now.a !== null && $('message').hidden"), json!(true));
    calm(&browser);
}
