//! Reads a scene of another program and writes it as `tauflow export` does, for the comparisons in `benches/mitsuba`.
//!
//! `import_scene FILE FOLDER [approximate]`: notes go to standard error, and nothing is written if anything is wrong.

use std::{error::Error, fs, path::Path};
use tauflow_scene::{Options, load_scene};

fn main() -> Result<(), Box<dyn Error>> {
    let args: Vec<String> = std::env::args().skip(1).collect();
    let [file, folder, how @ ..] = args.as_slice() else {
        return Err("usage: import_scene FILE FOLDER [approximate]".into());
    };
    let options = Options { approximate: how.iter().any(|h| h == "approximate"), ..Options::default() };
    let loaded = load_scene(Path::new(file), None, 0, options).map_err(|e| format!("\n{e}"))?;
    loaded.notes.iter().for_each(|note| eprintln!("note: {note}"));
    let folder = Path::new(folder);
    fs::create_dir_all(folder.join("blob"))?;
    for (digest, bytes) in &loaded.blobs {
        fs::write(folder.join("blob").join(digest.to_string()), bytes)?;
    }
    fs::write(folder.join("scene.json"), serde_json::to_string_pretty(&loaded.scene)?)?;
    let recipe = serde_json::json!({
        "stratum": "L0-open", "index": 0, "layout": "file", "layout_params": {}, "objects": [], "environment": "none",
        "side": null, "exposure_ev": 0.0
    });
    fs::write(folder.join("recipe.json"), recipe.to_string())?;
    Ok(())
}
