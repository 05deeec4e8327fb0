//! The one file that names all node kinds.

use crate::kinds::Registry;

/// Every kind there is.
pub fn registry() -> Registry {
    Registry::new(
        [
            tauflow_scene::kinds(),
            tauflow_render::kinds(),
            tauflow_report::kinds(),
        ]
        .into_iter()
        .flatten(),
    )
}
