//! The samples by backbone, as all pictures of the page need them.

use std::collections::BTreeMap;
use tauflow_contract::{Context, Handle, Items, KindError};
use tauflow_data::records::{Generated, GeneratedMeta, Variant};

/// A sample, whose images are not loaded yet.
pub(super) struct Sample<'a> {
    /// Key of its item.
    pub(super) key: String,
    /// What is said of it.
    pub(super) meta: GeneratedMeta,
    /// Its item.
    pub(super) item: Handle<'a, Generated>,
}

impl Sample<'_> {
    /// Whether it has a variant.
    pub(super) fn has(&self, variant: Variant) -> bool {
        self.meta.variants.iter().any(|its| its.variant == variant)
    }
}

/// The samples of each backbone, by number.
pub(super) type ByBackbone<'a> = BTreeMap<String, Vec<Sample<'a>>>;

/// Sorts samples by backbone and number.
///
/// # Errors
/// If a description is missing from the store or damaged.
pub(super) fn by_backbone<'a>(ctx: &Context<'_>, items: Items<'a, Generated>) -> Result<ByBackbone<'a>, KindError> {
    let mut found = ByBackbone::new();
    for (key, item) in items.iter() {
        let meta = Generated::meta(ctx, item)?;
        let own = found.entry(meta.backbone.as_str().to_owned()).or_default();
        own.push(Sample { key: key.to_string(), meta, item });
    }
    found.values_mut().for_each(|own| own.sort_by_key(|sample| sample.meta.sample));
    Ok(found)
}
