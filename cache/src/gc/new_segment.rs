//! Copies the entries that a collection keeps to a new segment.

use crate::{
    CacheError,
    error::At,
    layout::{Layout, names, sync_dir},
    lease::new_owner,
    network,
    segment::Sort,
};
use std::{
    fs::{self, File},
    io::Write,
    path::PathBuf,
};

/// A segment written aside and published whole. It has no live owner.
pub(super) struct NewSegment<'a> {
    layout: &'a Layout,
    sort: Sort,
    file: Option<(File, PathBuf)>,
    pub len: u64,
}

impl<'a> NewSegment<'a> {
    pub fn new(layout: &'a Layout, sort: Sort) -> Self {
        Self { layout, sort, file: None, len: 0 }
    }

    pub fn write(&mut self, frame: &[u8]) -> Result<(), CacheError> {
        if self.file.is_none() {
            let path = self.layout.tmp();
            self.file = Some((File::create_new(&path).at("create", &path)?, path));
        }
        let Some((file, path)) = &mut self.file else { return Ok(()) }; // set right above
        file.write_all(frame).at("write the segment", path)?;
        self.len += frame.len() as u64;
        Ok(())
    }

    /// Forgets what was written, and gives its space back.
    pub fn give_up(&mut self) {
        self.len = 0;
        if let Some((_, tmp)) = self.file.take() {
            let _ = fs::remove_file(tmp); // the next collection does
        }
    }

    pub fn publish(&mut self) -> Result<(), CacheError> {
        let Some((file, tmp)) = &self.file else { return Ok(()) };
        // A failure leaves it as it is, to be given up.
        file.sync_all().at("sync the segment", tmp)?;
        let folder = self.layout.folder(self.sort.folder());
        let last = names(&folder).at("list", &folder)?;
        let last = last.iter().filter_map(|name| self.sort.parse(name)).map(|(seq, _)| seq).max();
        let path = folder.join(self.sort.name(last.unwrap_or(0).saturating_add(1), &new_owner()));
        network::rename(tmp, &path).at("publish the segment", &path)?;
        (self.file, self.len) = (None, 0);
        sync_dir(&folder).at("sync the folder", &folder)
    }
}

impl Drop for NewSegment<'_> {
    fn drop(&mut self) {
        self.give_up();
    }
}
