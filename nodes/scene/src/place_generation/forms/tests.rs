//! The whole library.

use super::*;
use std::io::Write;

#[test]
fn export() {
    let Ok(folder) = std::env::var("FORMS_OUT") else { return };
    let only = std::env::var("FORMS_ONLY").unwrap_or_default();
    for form in forms() {
        if !only.is_empty() && !only.split(',').any(|o| form.name.starts_with(o)) {
            continue;
        }
        for variant in [0, 3] {
            let start = std::time::Instant::now();
            let made = form.make(variant);
            let time = start.elapsed().as_secs_f64() * 1e3;
            let mut file = std::fs::File::create(format!("{folder}/{}-{variant}.txt", form.name)).unwrap();
            let n: usize = made.parts.iter().map(|p| p.mesh.triangles.len()).sum();
            writeln!(file, "{} {time:.1} {}", n, made.solids.len()).unwrap();
            for b in &made.solids {
                writeln!(file, "b {:?} {:?}", b.low, b.high).unwrap();
            }
            for t in &made.tops {
                writeln!(file, "t {:?} {:?}", t.center, t.half).unwrap();
            }
            for part in &made.parts {
                writeln!(file, "p {:?}", part.stuff).unwrap();
                let normals = part.mesh.normals.as_ref().unwrap();
                for t in &part.mesh.triangles {
                    let mut line = String::from("f");
                    for i in t {
                        for v in part.mesh.positions[*i as usize] {
                            line += &format!(" {v:.5}");
                        }
                    }
                    for i in t {
                        for v in normals[*i as usize] {
                            line += &format!(" {v:.3}");
                        }
                    }
                    writeln!(file, "{line}").unwrap();
                }
            }
        }
    }
}
