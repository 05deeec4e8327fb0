//! Actions: the inputs and outputs of a kind.

use crate::{
    All, Artifact, Collection, Context, Each, Files, Handle, ItemKey, Items, KindError, Media, Out, Seen, Stored,
};
use std::collections::BTreeMap;

/// One unit of work.
#[derive(Debug)]
pub struct Action<'a, P> {
    /// The params this action reads: the projection, nothing more.
    pub params: P,
    /// The item, for sources and maps.
    pub item: Option<&'a ItemKey>,
    /// The group of output ports to make.
    pub group: &'a str,
    /// The derived seed; 0 for kinds that are not seeded.
    pub seed: u64,
    /// The item's artifact by port (and [`FILE_PORT`] for sources with files).
    pub each: BTreeMap<&'a str, &'a Artifact>,
    /// Whole collections by port.
    pub all: BTreeMap<&'a str, &'a Collection>,
}

/// Port on which a source's action finds the files outside that it reads.
pub const FILE_PORT: &str = "file";

fn unconnected(port: &str) -> KindError {
    KindError::Input(format!("input `{port}` is not connected"))
}

impl<'a, P> Action<'a, P> {
    /// The item on a port.
    ///
    /// # Errors
    /// [`KindError::Input`] if the port is not connected.
    pub fn handle<M: Media>(&self, port: Each<M>) -> Result<Handle<'a, M>, KindError> {
        self.handle_if(port)?.ok_or_else(|| unconnected(port.name()))
    }

    /// The item on a port that may be left unconnected.
    ///
    /// # Errors
    /// [`KindError::Input`] if the item is of another media type, which the engine keeps from happening.
    pub fn handle_if<M: Media>(&self, port: Each<M>) -> Result<Option<Handle<'a, M>>, KindError> {
        self.each.get(port.name()).map(|artifact| Handle::new(artifact)).transpose()
    }

    /// The item on a port, loaded.
    ///
    /// # Errors
    /// As [`Action::handle`] and [`Media::load`].
    pub fn read<M: Media>(&self, ctx: &Context<'_>, port: Each<M>) -> Result<M, KindError> {
        self.handle(port)?.load(ctx)
    }

    /// The item on a port that may be left unconnected, loaded.
    ///
    /// # Errors
    /// As [`Action::handle_if`] and [`Media::load`].
    pub fn read_if<M: Media>(&self, ctx: &Context<'_>, port: Each<M>) -> Result<Option<M>, KindError> {
        self.handle_if(port)?.map(|handle| handle.load(ctx)).transpose()
    }

    /// The collection on a port.
    ///
    /// # Errors
    /// [`KindError::Input`] if the port is not connected.
    pub fn all<M: Media>(&self, port: All<M>) -> Result<Items<'a, M>, KindError> {
        self.all_if(port)?.ok_or_else(|| unconnected(port.name()))
    }

    /// The collection on a port that may be left unconnected.
    ///
    /// # Errors
    /// [`KindError::Input`] if an item is of another media type, which the engine keeps from happening.
    pub fn all_if<M: Media>(&self, port: All<M>) -> Result<Option<Items<'a, M>>, KindError> {
        self.all.get(port.name()).map(|collection| Items::new(collection)).transpose()
    }

    /// The only item of the collection on a port.
    ///
    /// # Errors
    /// [`KindError::Input`] if the port is not connected, or its collection has not exactly one item.
    pub fn only<M: Media>(&self, port: All<M>) -> Result<Handle<'a, M>, KindError> {
        let empty = || {
            KindError::Input(format!(
                "input `{}` needs one item, but has none; connect a node that produces it",
                port.name()
            ))
        };
        self.only_if(port)?.ok_or_else(empty)
    }

    /// The only item of the collection on a port that may be left unconnected, or have no item.
    ///
    /// # Errors
    /// [`KindError::Input`] if its collection has several items.
    pub fn only_if<M: Media>(&self, port: All<M>) -> Result<Option<Handle<'a, M>>, KindError> {
        let Some(items) = self.all_if(port)? else { return Ok(None) };
        if items.len() > 1 {
            return Err(KindError::Input(format!(
                "input `{}` needs one item, but has {}; select one cell of the node, as in `node[axis=value]`",
                port.name(),
                items.len()
            )));
        }
        Ok(items.iter().next().map(|(_, handle)| handle))
    }

    /// The files outside that a source's item reads.
    ///
    /// # Errors
    /// [`KindError::Input`] if the item names none.
    pub fn files(&self) -> Result<Handle<'a, Files>, KindError> {
        Handle::new(self.each.get(FILE_PORT).copied().ok_or_else(|| unconnected(FILE_PORT))?)
    }

    /// The item's key.
    ///
    /// # Errors
    /// [`KindError::Internal`] for gathers, which have none.
    pub fn item(&self) -> Result<&'a ItemKey, KindError> {
        self.item.ok_or_else(|| KindError::Internal("an action without an item was asked for its key".into()))
    }
}

/// The outputs of an action, by output port of its group.
///
/// Sources and maps make at most one artifact on each port; gathers make collections.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Outputs {
    /// Artifacts of a source or map; a filter port may be absent.
    pub items: BTreeMap<String, Artifact>,
    /// Collections of a gather.
    pub collections: BTreeMap<String, Collection>,
    /// The files that external programs looked at, for kinds that run some ([`crate::Kind::runs_programs`]).
    pub seen: Option<Seen>,
}

impl Outputs {
    /// Puts an artifact on a port (sources and maps).
    pub fn put<M: Media>(mut self, port: Out<M>, artifact: Stored<M>) -> Self {
        self.items.insert(port.name().to_owned(), artifact.into_artifact());
        self
    }

    /// Puts a collection on a port (gathers).
    pub fn put_all<M: Media>(mut self, port: Out<M>, items: impl IntoIterator<Item = (ItemKey, Stored<M>)>) -> Self {
        let items = items.into_iter().map(|(key, artifact)| (key, artifact.into_artifact())).collect();
        self.collections.insert(port.name().to_owned(), items);
        self
    }

    /// Puts a collection of one item on a port (gathers).
    ///
    /// # Errors
    /// [`KindError::Internal`] if `key` cannot be an item key.
    pub fn put_one<M: Media>(self, port: Out<M>, key: &str, artifact: Stored<M>) -> Result<Self, KindError> {
        let key = ItemKey::new(key).map_err(|e| KindError::Internal(e.to_string()))?;
        Ok(self.put_all(port, [(key, artifact)]))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use tauflow_cache::Digest;

    #[test]
    fn ports_hand_out_what_they_are_of() {
        const IN: All<Files> = All::new("in", "Files.");
        const MORE: All<Files> = All::new("more", "Files.").or_none();
        let file = |name: &str| Artifact::tree(Files::NAME, [(name.to_owned(), Digest::of(name.as_bytes()))]);
        let key = |text: &str| ItemKey::new(text).expect("plain");
        let two: Collection = [(key("a"), file("a")), (key("b"), file("b"))].into_iter().collect();
        let all = BTreeMap::from([("in", &two)]);
        let action = Action { params: (), item: None, group: "main", seed: 0, each: BTreeMap::new(), all };
        assert_eq!(action.all(IN).expect("connected").len(), 2);
        assert!(action.all_if(MORE).expect("optional").is_none());
        assert!(action.only(IN).expect_err("two items").to_string().contains("has 2"));
        assert!(action.all(MORE).expect_err("unconnected").to_string().contains("`more`"));
    }
}
