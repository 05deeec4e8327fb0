//! Scenes as `tauflow export` writes them.

use std::{collections::BTreeMap, path::Path, sync::atomic::AtomicBool};
use tauflow_contract::{Context, Digest, KindError, Media, MemoryBlobs, Silent};
use tauflow_data::{Scene, folder::DiskFolder, records::SceneRecord};

/// Blobs by digest.
pub type Blobs = BTreeMap<Digest, Vec<u8>>;

/// A scene and the blobs that it names.
pub fn read(folder: &Path) -> Result<(Scene, Blobs), KindError> {
    let (memory, stop) = (MemoryBlobs::default(), AtomicBool::new(false));
    let ctx = Context::new(&memory, &Silent, &stop);
    let stored = SceneRecord::import(&ctx, &DiskFolder::new(folder))?;
    let scene = SceneRecord::scene(&ctx, stored.handle())?;
    let blob = |digest: Digest| Ok((digest, ctx.get(&digest)?));
    let blobs = scene.blobs().into_iter().map(blob).collect::<Result<_, KindError>>()?;
    Ok((scene, blobs))
}
