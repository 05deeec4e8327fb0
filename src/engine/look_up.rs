//! Answers what a scheduler asks: whether actions were done before, which items a source has, what a listing holds.
//! Done on threads of their own, so that the scheduler never waits for the store. Actions are looked up by the bundle,
//! because most were done before, and a look-up costs less than passing a message.

use super::{
    EngineError,
    action::{action_key, files_artifact, panicked},
    execute::Whole,
    holdings::Holdings,
    ids::{InputId, LaneId, SlotId},
    records::ACTION,
    request::{Finding, LookUp, LookUps, LookedUp, Merge, Merged, Request, Response, ShardRead, Task, Todo, prefixed},
    rollup,
    sharded::{Here, Items, Sharded},
    sighted::Looks,
};
use serde_json::Value;
use std::{
    panic::{AssertUnwindSafe, catch_unwind},
    sync::Arc,
};
use tauflow_cache::{CacheError, Digest, Key, Record};
use tauflow_contract::{ActionKey, Artifact, NodeKind, SourceItem};

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
    /// Answers a request.
    pub fn answer(&self, request: Request) -> Response {
        let answer = || -> Result<Response, CacheError> {
            Ok(match request {
                Request::List { lane, kind, params } => Response::Listed { lane, items: list(&*kind, &params) },
                Request::Actions(bundle) => Response::Actions(self.look_up(&bundle)),
                Request::Shards(asked) => {
                    let lane = asked.task.lane;
                    Response::Shards { lane, found: rollup::find_shards(asked, self.holdings)? }
                }
                Request::Read(shards) => {
                    Response::Read(shards.into_iter().map(|shard| self.read(shard)).collect::<Result<_, _>>()?)
                }
                Request::Merge(of) => {
                    let (lane, input) = (of.lane, of.input);
                    Response::Merged { lane, input, merged: self.merge(&of)? }
                }
                Request::Keep(all) => {
                    all.iter().try_for_each(|of| rollup::keep(self.holdings.store, of))?;
                    Response::Kept
                }
            })
        };
        match catch_unwind(AssertUnwindSafe(answer)) {
            Ok(Ok(answer)) => answer,
            Ok(Err(error)) => Response::Fatal(error.into()),
            Err(panic) => Response::Fatal(EngineError::Request(panicked(&panic))),
        }
    }

    /// Has a shard read its items.
    fn read(&self, of: ShardRead) -> Result<(ShardRead, Here<()>), CacheError> {
        let read = of.shard.items(self.holdings.store)?.map(drop);
        Ok((of, read))
    }

    /// Merges collections.
    fn merge(&self, of: &Merge) -> Result<Merged, CacheError> {
        let (mut merged, mut gone) = (Items::new(), Vec::new());
        for (prefix, collection) in &of.feeds {
            match collection.items(self.holdings.store)? {
                Ok(items) => {
                    for (key, output) in items {
                        match prefixed(prefix.as_deref(), &key) {
                            Ok(key) => merged.push((key, output)),
                            Err(message) => return Ok(Merged::Failed(message)),
                        }
                    }
                }
                Err(blob) => {
                    gone.push(blob);
                    gone.extend(collection.blobs(self.holdings.store)?.1);
                }
            }
        }
        if !gone.is_empty() {
            return Ok(Merged::Missing(gone));
        }
        merged.sort_by(|a, b| a.0.cmp(&b.0));
        Ok(match merged.windows(2).find(|pair| pair[0].0 == pair[1].0) {
            Some(pair) => Merged::Failed(format!("two nodes on input `{}` produce an item `{}`", of.port, pair[0].0)),
            None => Merged::Whole(Arc::new(Sharded::of(merged))),
        })
    }

    /// Looks actions up; a panic is an answer, too.
    fn look_up(&self, bundle: &LookUps) -> Vec<LookedUp> {
        let lane = bundle.task.lane;
        catch_unwind(AssertUnwindSafe(|| self.find(bundle))).unwrap_or_else(|panic| {
            let message = panicked(&panic);
            let failed = |slot: SlotId| LookedUp::of((lane, slot), Finding::Failed(message.clone()));
            bundle.actions.iter().map(|action| failed(action.slot)).collect()
        })
    }

    fn find(&self, bundle: &LookUps) -> Vec<LookedUp> {
        let task = &bundle.task;
        let mut keyed: Vec<_> = bundle.actions.iter().map(|of| (of, self.key_of(task, &bundle.whole, of))).collect();
        if task.programs {
            let mut looks = Looks::default();
            for (_, found) in &mut keyed {
                if let Ok(of) = found {
                    match looks.find(self.holdings.store, &of.0) {
                        Ok((key, _)) => (of.1, of.0) = (key.hash(), key),
                        Err(error) => *found = Err(Finding::Fatal(error)),
                    }
                }
            }
        }
        let hashes: Vec<Key> = keyed.iter().filter_map(|(_, key)| Some(key.as_ref().ok()?.1)).collect();
        let mut records = self.holdings.store.lookup_many(ACTION, &hashes).into_iter();
        let looked_up = |(of, key): (&LookUp, Result<Keyed, Finding>)| {
            let slot: (LaneId, SlotId) = (task.lane, of.slot);
            let (key, hash, file) = match key {
                Ok(found) => found,
                Err(standing) => return LookedUp::of(slot, standing),
            };
            let digest = file.as_ref().map(Artifact::digest);
            let kept = self.keep_keys.then(|| Box::new(key.clone()));
            let record = records.next().flatten();
            let standing = self.standing(task, of, record.as_deref(), (key, hash, file)).unwrap_or_else(Finding::Fatal);
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
    ) -> Result<Finding, CacheError> {
        let before = self.holdings.made(record, &task.producer.spec, task.producer.group)?;
        Ok(match before {
            Some(made) if self.dry || !self.sampled(&hash) => Finding::Hit(made),
            None if self.dry => Finding::WouldRun { lost: record.is_some(), gone: self.gone(of) },
            before => Finding::Todo(Box::new(Todo { key, hash, file, before })),
        })
    }

    /// The inputs of an action of which blobs are not there.
    fn gone(&self, of: &LookUp) -> Vec<InputId> {
        let is_gone = |artifact: &Artifact| artifact.parts.values().any(|digest| !self.holdings.is_here(digest));
        of.each.iter().filter(|(_, output)| is_gone(&output.artifact)).map(|(input, _)| *input).collect()
    }

    /// The key of an action, its hash, and the artifact of the files that it reads.
    fn key_of(&self, task: &Task, whole: &Whole, of: &LookUp) -> Result<Keyed, Finding> {
        let derive = || {
            let file = match self.import(of) {
                Ok(Ok(file)) => file,
                Ok(Err(message)) => return Err(Finding::Failed(message)),
                Err(error) => return Err(Finding::Fatal(error)),
            };
            let key = action_key(task, whole, of, file.as_ref());
            let hash = key.hash();
            Ok((key, hash, file))
        };
        catch_unwind(AssertUnwindSafe(derive)).unwrap_or_else(|panic| Err(Finding::Failed(panicked(&panic))))
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

/// The items of a source, in order.
fn list(kind: &dyn NodeKind, params: &Value) -> Result<Vec<SourceItem>, String> {
    let listed = catch_unwind(AssertUnwindSafe(|| kind.items(params)));
    let mut items = match listed {
        Ok(Ok(items)) => items,
        Ok(Err(error)) => return Err(error.to_string()),
        Err(_) => return Err("internal error: listing the items panicked; please report it".into()),
    };
    items.sort_by(|a, b| a.key.cmp(&b.key));
    match items.windows(2).find(|pair| pair[0].key == pair[1].key) {
        Some(pair) => Err(format!("two items have the key `{}`; please report it", pair[0].key)),
        None => Ok(items),
    }
}
