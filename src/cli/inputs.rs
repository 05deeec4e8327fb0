//! The files that a command reads: no result is written over one of them, also not through a link.

use super::{CliError, scene::is_stream};
use std::{
    collections::BTreeMap,
    path::{Path, PathBuf},
};

/// Files that are read, as they were named, by their places without links.
#[derive(Default)]
pub(crate) struct Inputs(BTreeMap<PathBuf, PathBuf>);

impl Inputs {
    /// Leaves out files that are not there: whoever reads them tells of it.
    pub(crate) fn of(paths: impl IntoIterator<Item = impl Into<PathBuf>>) -> Self {
        let place = |path: PathBuf| Some((path.canonicalize().ok()?, path));
        Self(paths.into_iter().map(Into::into).filter_map(place).collect())
    }

    /// The name of the file that writing to `out` would replace.
    pub(crate) fn at(&self, out: &Path) -> Option<&Path> {
        let place = if is_stream(out) { None } else { out.canonicalize().ok() };
        self.0.get(&place?).map(PathBuf::as_path)
    }

    /// Refuses to write a result over one of them.
    pub(crate) fn spare(&self, out: &Path) -> Result<(), CliError> {
        let Some(name) = self.at(out) else { return Ok(()) };
        let (name, out) = (name.display(), out.display());
        let what = format!("{name} is read, and would be overwritten by the result {out}; name another file with -o");
        Err(CliError::Bad(what))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::{fs, os::unix::fs::symlink};

    #[test]
    fn no_input_is_written_over() {
        let folder = tempfile::tempdir().expect("a folder");
        let at = |name: &str| folder.path().join(name);
        fs::write(at("in.exr"), "in").expect("writable");
        fs::write(at("other.exr"), "other").expect("writable");
        fs::create_dir(at("sub")).expect("writable");
        symlink("in.exr", at("link.exr")).expect("writable");
        let inputs = Inputs::of([at("in.exr"), at("none.exr")]);
        for out in ["in.exr", "link.exr", "sub/../in.exr"] {
            let told = inputs.spare(&at(out)).expect_err("it is read").to_string();
            assert!(told.contains("in.exr is read, and would be overwritten") && told.contains(out), "{told}");
        }
        for out in ["other.exr", "none.exr", "new.exr", "sub/in.exr"] {
            assert!(inputs.spare(&at(out)).is_ok(), "{out}");
        }
        let through = Inputs::of([at("link.exr")]);
        assert!(through.spare(&at("in.exr")).is_err());
    }
}
