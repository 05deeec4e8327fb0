//! Look-ups: whether actions were done before. Done on threads of their own, by the bundle, because most actions were,
//! and a look-up costs less than passing a message.

use super::{
    action::{action_key, files_artifact, panicked},
    execute::Whole,
    holdings::Holdings,
    ids::{InputId, LaneId, SlotId},
    job::{LookUp, LookUps, LookedUp, Standing, Task, Todo},
    records::ACTION,
};
use std::panic::{AssertUnwindSafe, catch_unwind};
use tauflow_cache::{CacheError, Digest, Key, Record};
use tauflow_contract::{ActionKey, Artifact};

/// How a run looks things up.
#[derive(Clone, Copy)]
pub struct Catalog<'a> {
    /// The store and what is beside it.
    pub holdings: Holdings<'a>,
    /// Look up only, run nothing.
    pub dry: bool,
    /// Give the keys back.
    pub keep_keys: bool,
    /// The share of hits that run again and are compared.
    pub recheck: f64,
}

/// The key of an action, its hash, and the artifact of the files outside that it reads.
type Keyed = (ActionKey, Key, Option<Artifact>);

impl Catalog<'_> {
    /// Looks actions up; a panic is an answer, too.
    pub fn look_up(&self, bundle: &LookUps) -> Vec<LookedUp> {
        let lane = bundle.task.lane;
        catch_unwind(AssertUnwindSafe(|| self.find(bundle))).unwrap_or_else(|panic| {
            let message = panicked(&panic);
            let failed = |slot: SlotId| LookedUp::of((lane, slot), Standing::Failed(message.clone()));
            bundle.actions.iter().map(|action| failed(action.slot)).collect()
        })
    }

    fn find(&self, bundle: &LookUps) -> Vec<LookedUp> {
        let task = &bundle.task;
        let keyed: Vec<_> = bundle.actions.iter().map(|of| (of, self.key_of(task, &bundle.whole, of))).collect();
        let hashes: Vec<Key> = keyed.iter().filter_map(|(_, key)| Some(key.as_ref().ok()?.1)).collect();
        let mut records = self.holdings.store.lookup_many(ACTION, &hashes).into_iter();
        let looked_up = |(of, key): (&LookUp, Result<Keyed, Standing>)| {
            let slot: (LaneId, SlotId) = (task.lane, of.slot);
            let (key, hash, file) = match key {
                Ok(found) => found,
                Err(standing) => return LookedUp::of(slot, standing),
            };
            let digest = file.as_ref().map(Artifact::digest);
            let kept = self.keep_keys.then(|| Box::new(key.clone()));
            let record = records.next().flatten();
            let standing =
                self.standing(task, of, record.as_deref(), (key, hash, file)).unwrap_or_else(Standing::Fatal);
            LookedUp { key: kept, file: digest, ..LookedUp::of(slot, standing) }
        };
        keyed.into_iter().map(looked_up).collect()
    }

    fn standing(
        &self,
        task: &Task,
        of: &LookUp,
        record: Option<&Record>,
        (key, hash, file): Keyed,
    ) -> Result<Standing, CacheError> {
        let before = self.holdings.made(record, &task.producer.spec, task.producer.group)?;
        Ok(match before {
            Some(made) if self.dry || !self.sampled(&hash) => Standing::Hit(made),
            None if self.dry => Standing::WouldRun { lost: record.is_some(), gone: self.gone(of) },
            before => Standing::Todo(Box::new(Todo { key, hash, file, before })),
        })
    }

    /// The inputs of an action of which blobs are not there.
    fn gone(&self, of: &LookUp) -> Vec<InputId> {
        let is_gone = |artifact: &Artifact| artifact.parts.values().any(|digest| !self.holdings.is_here(digest));
        of.each.iter().filter(|(_, output)| is_gone(&output.artifact)).map(|(input, _)| *input).collect()
    }

    /// The key of an action, its hash, and the artifact of the files that it reads.
    fn key_of(&self, task: &Task, whole: &Whole, of: &LookUp) -> Result<Keyed, Standing> {
        let derive = || {
            let file = match self.import(of) {
                Ok(Ok(file)) => file,
                Ok(Err(message)) => return Err(Standing::Failed(message)),
                Err(error) => return Err(Standing::Fatal(error)),
            };
            let key = action_key(task, whole, of, file.as_ref());
            let hash = key.hash();
            Ok((key, hash, file))
        };
        catch_unwind(AssertUnwindSafe(derive)).unwrap_or_else(|panic| Err(Standing::Failed(panicked(&panic))))
    }

    /// Digests a source's files and imports them.
    fn import(&self, of: &LookUp) -> Result<Result<Option<Artifact>, String>, CacheError> {
        if of.files.is_empty() {
            return Ok(Ok(None));
        }
        let store = self.holdings.store;
        let put = |bytes: &[u8]| if self.dry { Ok(Digest::of(bytes)) } else { store.put(bytes) };
        Ok(files_artifact(&of.files, put)?.map(Some))
    }

    fn sampled(&self, hash: &Key) -> bool {
        let head = u32::from_le_bytes([hash.0[0], hash.0[1], hash.0[2], hash.0[3]]);
        f64::from(head) < self.recheck * f64::from(u32::MAX)
    }
}
