//! Folders of items: what goes out comes back, and nothing else.

use super::*;
use crate::{
    Image,
    records::{Exposure, Ladder, LadderMeta, PackedScene, Refined, RefinedImage, Rung},
};
use std::sync::atomic::AtomicBool;
use tauflow_contract::{FileTree, Files, Media, MemoryBlobs, Silent};

fn in_folder(test: impl FnOnce(&Context<'_>, &Path)) {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let (blobs, stop) = (MemoryBlobs::default(), AtomicBool::new(false));
    test(&Context::new(&blobs, &Silent, &stop), &folder.path().join("out"));
}

fn key(text: &str) -> ItemKey {
    ItemKey::new(text).expect("plain")
}

fn collection(ctx: &Context<'_>, rungs: u64) -> Collection {
    let image = |nfe| {
        let said = RefinedImage { method: "mc_noise".into(), from_spp: 1, to_spp: 4, nfe };
        (said, Image::from_data(2, 1, 3, vec![0.1, 1.0, 7.5, 0.0, 2.0, nfe as f32]).expect("fits"))
    };
    let refined = Refined { images: (1..=rungs).map(image).collect(), note: None, ..Default::default() };
    let exposure = Exposure { factor: 0.3, ev: 0.0, mean_luminance: 0.6 };
    let files = Files(FileTree::from([("maps/a.txt".into(), b"1".to_vec()), ("b".into(), Vec::new())]));
    [
        (key("a"), refined.store(ctx).expect("in memory").into_artifact()),
        (key("method=x/a"), exposure.store(ctx).expect("in memory").into_artifact()),
        // Its folder lies in that of the first.
        (key("a/b"), files.store(ctx).expect("in memory").into_artifact()),
    ]
    .into_iter()
    .collect()
}

fn export(ctx: &Context<'_>, of: &Collection, path: &Path) -> Manifest {
    let mut out = DiskFolder::new(path);
    begin(&out);
    let items = of.iter().map(|(item, artifact)| export_item(ctx, item, artifact, &out).expect("whole"));
    let manifest = Manifest { node: "n".into(), items: items.collect(), ..Manifest::default() };
    finish(&mut out, &manifest).expect("a folder that can be written");
    manifest
}

#[test]
fn what_is_exported_is_imported() {
    in_folder(|ctx, path| {
        // Files of an earlier, longer export are not read.
        export(ctx, &collection(ctx, 2), path);
        assert!(path.join("a/mc_noise-1-to-4-nfe-2.exr").is_file());
        let items = collection(ctx, 1);
        let manifest = export(ctx, &items, path);
        assert_eq!(import_items(ctx, &DiskFolder::new(path)).expect("own files"), items);
        let first = &manifest.items[0];
        let files = first.files.as_ref().expect("listed");
        assert!(files.iter().all(|name| path.join(first.item.as_str()).join(name).is_file()), "{files:?}");
        assert_eq!(first.digest, items.get(first.item.as_str()).map(Artifact::digest));
        let all = DiskFolder::new(path).names().expect("listed");
        assert!(all.contains(&"a/b/maps/a.txt".to_owned()) && all.is_sorted(), "{all:?}");
        assert!(all.iter().all(|name| !name.ends_with(".tmp")), "{all:?}");
    });
}

#[test]
fn other_programs_need_no_digests_and_may_change_values() {
    in_folder(|ctx, path| {
        let mut folder = DiskFolder::new(path);
        let manifest = r#"{"items": [{"item": "x", "media": "tauflow/exposure"}]}"#;
        folder.put(MANIFEST, manifest.as_bytes()).expect("a folder that can be written");
        let gone = import_items(ctx, &folder).expect_err("no file of the item").to_string();
        assert!(gone.contains("`x`") && gone.contains("value.json"), "{gone}");
        let value = br#"{"factor": 2.0, "ev": 0.0, "mean_luminance": 0.09}"#;
        folder.put("x/value.json", value).expect("a folder that can be written");
        let items = import_items(ctx, &folder).expect("all is there");
        let exposure = Exposure::load(ctx, items.get("x").expect("there")).expect("whole");
        assert_eq!(exposure.factor, 2.0);
        let unknown = manifest.replace("exposure", "exposition");
        folder.put(MANIFEST, unknown.as_bytes()).expect("a folder that can be written");
        let error = import_items(ctx, &folder).expect_err("no such type").to_string();
        assert!(error.contains("`tauflow/exposition`") && error.contains("tauflow/exposure,"), "{error}");
        let outside = manifest.replace("\"x\"", "\"../x\"");
        folder.put(MANIFEST, outside.as_bytes()).expect("a folder that can be written");
        assert!(import_items(ctx, &folder).is_err(), "a key that leads out of the folder");
    });
}

#[test]
fn a_manifest_stands_for_a_whole_export_alone() {
    in_folder(|ctx, path| {
        let items = collection(ctx, 1);
        export(ctx, &items, path);
        let out = DiskFolder::new(path);
        begin(&out);
        let item = key("new");
        let lost = Artifact::blob(Exposure::NAME, Digest::of(b"never stored"));
        // An export that fails before its first file changes nothing in the folder.
        assert!(matches!(export_item(ctx, &item, &lost, &out), Err(KindError::MissingBlob(_))));
        assert_eq!(import_items(ctx, &DiskFolder::new(path)).expect("still whole"), items);
        // Once a file is written, the earlier manifest is gone.
        let (first, artifact) = items.iter().next().expect("an item");
        export_item(ctx, first, artifact, &out).expect("whole");
        assert!(!path.join(MANIFEST).exists());
        let error = import_items(ctx, &out).expect_err("no manifest").to_string();
        assert!(error.contains(MANIFEST), "{error}");
        let alien = Artifact::blob("other/thing", Digest::of(b""));
        assert!(export_item(ctx, &item, &alien, &out).expect_err("unknown").to_string().contains("other/thing"));
    });
}

#[test]
fn no_name_leads_out_of_the_folder() {
    in_folder(|ctx, path| {
        let mut folder = DiskFolder::new(path);
        for name in ["../a", "/a", "a/../../b", "", "a/", "..", "./..", "a\\b", "/tmp/../a", "."] {
            let error = folder.put(name, b"x").expect_err(name).to_string();
            assert!(error.contains(&format!("`{name}`")) && error.contains("out"), "{error}");
            assert!(folder.get(name).is_err(), "{name}");
        }
        // A tree that was stored with such a name writes none of it outside.
        let parts = [("../escaped".to_owned(), ctx.put(b"x").expect("in memory"))];
        let tree = Artifact::tree(Files::NAME, parts);
        assert!(export_item(ctx, &key("item"), &tree, &folder).is_err());
        assert!(!path.join("escaped").exists());
        assert!(folder.get("not-there").expect("a plain name").is_none());
    });
}

#[test]
fn files_are_written_whole_and_leave_nothing_beside_them() {
    in_folder(|_, path| {
        let mut folder = DiskFolder::new(path);
        folder.put("a/b.txt", b"one").expect("a folder that can be written");
        folder.put("a/b.txt", b"two").expect("a file that can be replaced");
        assert_eq!(folder.get("a/b.txt").expect("there").as_deref(), Some(&b"two"[..]));
        // A folder stands where the file should: nothing of it is left.
        fs::create_dir_all(path.join("a/c/d")).expect("made");
        assert!(matches!(folder.put("a/c", b"x"), Err(KindError::Environment(_))));
        fs::write(path.join("a/.b.txt.1.tmp"), b"half").expect("written");
        let found: Vec<_> = fs::read_dir(path.join("a")).expect("listed").map(|e| e.expect("there")).collect();
        assert_eq!(found.len(), 3, "{found:?}");
        assert_eq!(folder.names().expect("listed"), ["a/b.txt"]);
    });
}

#[test]
fn items_that_meet_in_a_file_are_both_named() {
    in_folder(|ctx, path| {
        let files = |name: &str, bytes: &[u8]| {
            let files = Files(FileTree::from([(name.to_owned(), bytes.to_vec())]));
            files.store(ctx).expect("in memory").into_artifact()
        };
        for (first, second) in [("b/x", "x"), ("b", "x"), ("b/x/y", "x")] {
            let out = DiskFolder::new(path);
            export_item(ctx, &key("a"), &files(first, b"1"), &out).expect("nothing is there");
            let error = export_item(ctx, &key("a/b"), &files(second, b"2"), &out).expect_err("they meet");
            let said = error.to_string();
            assert!(said.contains("`a` and `a/b` would be written to the same file") && said.contains("a/b"), "{said}");
            let kept = fs::read(path.join("a").join(first)).expect("the first stays");
            assert_eq!(kept, b"1");
            // An item may be written again, and so may all in another folder of that name.
            export_item(ctx, &key("a"), &files(first, b"3"), &out).expect("its own");
            fs::remove_dir_all(path).expect("it is ours");
        }
        let mut out = DiskFolder::new(path);
        export_item(ctx, &key(MANIFEST), &files("x", b"1"), &out).expect("nothing is there");
        let said = finish(&mut out, &Manifest::default()).expect_err("it is a folder").to_string();
        assert!(said.contains("the list of all items"), "{said}");
    });
}

#[test]
fn what_is_no_regular_file_is_refused_and_not_waited_for() {
    in_folder(|_, path| {
        fs::create_dir_all(path).expect("made");
        for (name, device) in [("zero", "/dev/zero"), ("terminal", "/dev/tty")] {
            std::os::unix::fs::symlink(device, path.join(name)).expect("made");
        }
        let folder = DiskFolder::new(path);
        let Err(KindError::Input(told)) = folder.get("zero") else { panic!("a device without an end") };
        assert!(told.contains("zero: it is not a regular file"), "{told}");
        assert!(folder.get("terminal").is_err() && folder.get("nothing").expect("not there").is_none());
    });
}

#[test]
fn hidden_files_are_no_part_of_a_folder() {
    in_folder(|ctx, path| {
        fs::create_dir_all(path.join(".git")).expect("made");
        for name in ["a", ".DS_Store", ".git/config"] {
            fs::write(path.join(name), name).expect("written");
        }
        let mut folder = DiskFolder::new(path);
        assert_eq!(folder.names().expect("listed"), ["a"]);
        assert!(folder.put(".bashrc", b"x").is_err() && folder.put("a/.git/config", b"x").is_err());
        let parts = [(".bashrc".to_owned(), ctx.put(b"x").expect("in memory"))];
        assert!(export_item(ctx, &key("item"), &Artifact::tree(Files::NAME, parts), &folder).is_err());
    });
}

/// A ladder, a packed scene and a refined image of one scene, of exposure 0.3.
fn radiances(ctx: &Context<'_>) -> Collection {
    let raw = Image::from_data(2, 1, 3, vec![0.1, 1.0, 7.5, 0.0, 2.0, 1e-3]).expect("fits");
    let exposed = raw.map(|v| (f64::from(v) * 0.3) as f32);
    let meta = serde_json::json!({"counts": [1], "width": 2, "height": 1, "rejected": 0, "mean_path_length": 1.5});
    let meta: LadderMeta = serde_json::from_value(meta).expect("a ladder's");
    let ladder = Ladder { meta, rungs: vec![Rung { spp: 1, image: raw.clone() }], variance: raw };
    let packed =
        PackedScene { counts: vec![1], states: vec![exposed.clone()], gbuffer: None, sampler: Default::default() };
    let said = RefinedImage { method: "mc_noise".into(), from_spp: 1, to_spp: 4, nfe: 1 };
    let refined = Refined { images: vec![(said, exposed)], note: None, ..Default::default() };
    [
        (key("ladder"), ladder.store(ctx).expect("in memory").into_artifact()),
        (key("packed"), packed.store(ctx).expect("in memory").into_artifact()),
        (key("refined"), refined.store(ctx).expect("in memory").into_artifact()),
    ]
    .into_iter()
    .collect()
}

#[test]
fn the_space_and_exposure_of_images_are_named_and_raw_radiance_can_be_asked_for() {
    in_folder(|ctx, path| {
        let items = radiances(ctx);
        let files =
            [("ladder", "spp-000001.exr"), ("packed", "spp-000001.exr"), ("refined", "mc_noise-1-to-4-nfe-1.exr")];
        let image = |name: &str, file: &str| {
            let bytes = fs::read(path.join(name).join(file)).expect("there");
            crate::image_io::parse_exr(file, &bytes).expect("a picture").remove("").expect("unnamed")
        };
        let meta = |name: &str| -> serde_json::Value {
            serde_json::from_slice(&fs::read(path.join(name).join("meta.json")).expect("there")).expect("JSON")
        };
        let export = |radiance: Radiance| {
            let out = DiskFolder::new(path).with_radiance(radiance);
            begin(&out);
            let items: Result<Vec<_>, _> = items.iter().map(|(item, of)| export_item(ctx, item, of, &out)).collect();
            finish(&mut DiskFolder::new(path), &Manifest { items: items?, ..Manifest::default() })
        };
        let exposure = Some(0.3);
        // As they are: to the bit.
        export(Radiance { exposure, raw: false }).expect("written");
        assert_eq!(import_items(ctx, &DiskFolder::new(path)).expect("own files"), items);
        for (name, space, factor) in
            [("ladder", "raw_radiance", 1.0), ("packed", "exposed_radiance", 0.3), ("refined", "exposed_radiance", 0.3)]
        {
            let meta = meta(name);
            assert_eq!((&meta["space"], &meta["exposure"]), (&space.into(), &factor.into()), "{name}: {meta}");
            assert_eq!(meta["scene_exposure"], 0.3, "{name}");
        }
        let raw = image("ladder", files[0].1);
        // All as raw radiance: one picture, and back to what it was but for rounding.
        export(Radiance { exposure, raw: true }).expect("written");
        for (name, file) in files {
            assert_eq!(
                (&meta(name)["space"], &meta(name)["exposure"]),
                (&"raw_radiance".into(), &1.0.into()),
                "{name}"
            );
            let found = image(name, file);
            let near = |(a, b): (&f32, &f32)| (a - b).abs() <= 2e-7 * b.abs();
            assert!(found.data().iter().zip(raw.data()).all(near), "{name}: {found:?}");
        }
        let back = import_items(ctx, &DiskFolder::new(path)).expect("own files");
        let packed = PackedScene::load(ctx, back.get("packed").expect("there")).expect("whole");
        let near = |(a, b): (&f32, &f32)| (f64::from(*a) - f64::from(*b) * 0.3).abs() <= 3e-7 * f64::from(*a).abs();
        assert!(packed.states[0].data().iter().zip(raw.data()).all(near), "{packed:?}");
        // Without a known exposure nothing says by what to divide.
        export(Radiance::default()).expect("written as it is");
        assert!(meta("packed").get("exposure").is_none() && meta("packed")["space"] == "exposed_radiance");
        let told = export(Radiance { exposure: None, raw: true }).expect_err("unknown").to_string();
        assert!(told.contains("its exposure is not known") && told.contains("--raw"), "{told}");
    });
}

#[test]
fn images_of_other_programs_without_a_space_are_read_as_they_are() {
    in_folder(|ctx, path| {
        let items = radiances(ctx);
        export(ctx, &items, path);
        let file = path.join("refined/meta.json");
        let mut meta: serde_json::Value = serde_json::from_slice(&fs::read(&file).expect("there")).expect("JSON");
        meta.as_object_mut().expect("an object").remove("space");
        fs::write(&file, meta.to_string()).expect("written");
        fs::remove_file(path.join("packed/meta.json")).expect("there");
        let manifest = fs::read_to_string(path.join(MANIFEST)).expect("there");
        let mut manifest: Manifest = serde_json::from_str(&manifest).expect("JSON");
        manifest.items.iter_mut().for_each(|item| item.files = None);
        finish(&mut DiskFolder::new(path), &manifest).expect("written");
        assert_eq!(import_items(ctx, &DiskFolder::new(path)).expect("own files"), items);
        // Raw radiance of no known scene cannot be exposed.
        meta["space"] = "raw_radiance".into();
        fs::write(&file, meta.to_string()).expect("written");
        let told = import_items(ctx, &DiskFolder::new(path)).expect_err("no factor").to_string();
        assert!(told.contains("`refined`") && told.contains("scene_exposure"), "{told}");
    });
}
