//! Answers what a scheduler asks: whether actions were done before, which items a source has, what a listing holds.
//! Done on threads of their own, so that the scheduler never waits for the store. Actions are looked up by the bundle,
//! because most were done before, and a look-up costs less than passing a message.

use super::{
    EngineError,
    action::{action_key, files_artifact, panicked},
    execute::Whole,
    holdings::Holdings,
    ids::{InputId, LaneId, SlotId},
    output::Items,
    records::{ACTION, Payload},
    request::{
        Finding, LaneListing, ListingRead, LookUp, LookUps, LookedUp, Merge, Merged, Request, Response, ShardRead,
        Task, Todo, prefixed,
    },
    rollup,
    sharded::{Here, Listed, Shard, Sharded},
    sighted::{self, Sighted},
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
    /// The same share of hits that came from an upstream. Each machine audits others.
    pub audit: f64,
    /// What tells this machine's share from those of others.
    pub salt: u32,
}

/// The key of an action, its hash, and the artifact of the files outside that it reads.
type Keyed = (ActionKey, Key, Option<Artifact>);

impl Catalog<'_> {
    /// Answers a request.
    pub fn answer(&self, request: Request) -> Response {
        let answer = || -> Result<Response, CacheError> {
            Ok(match request {
                Request::List { lane, kind, params } => Response::Listed { lane, items: list(&*kind, &params) },
                Request::Actions(bundle) => Response::Actions(self.look_up(&bundle)?),
                Request::Shards(asked) => {
                    let lane = asked.task.lane;
                    Response::Shards { lane, found: rollup::find_shards(asked, self.holdings)? }
                }
                Request::Lanes(asked) => Response::Lanes(rollup::find_lanes(&asked, self.holdings)?),
                Request::Listings(asked) => Response::Listings(self.listings(asked)?),
                Request::Read(shards) => Response::Read(self.read(shards)?),
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

    /// Has shards read their items.
    fn read(&self, asked: Vec<ShardRead>) -> Result<Vec<(ShardRead, Here<()>)>, CacheError> {
        let shards: Vec<&Shard> = asked.iter().map(|of| &*of.shard).collect();
        let read = Shard::read(self.holdings.store, &shards)?;
        Ok(asked.into_iter().zip(read).collect())
    }

    /// Reads the listings of collections.
    fn listings(&self, asked: Vec<LaneListing>) -> Result<Vec<ListingRead>, CacheError> {
        let blobs: Vec<(&Listed, &'static str)> = asked.iter().map(|of| (&of.listed, of.media)).collect();
        let read = Sharded::get_many(self.holdings.store, &blobs)?;
        Ok(asked.iter().zip(read).map(|(of, read)| (of.lane, of.port, read.map(Arc::new))).collect())
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
            Some(pair) => Merged::Failed(format!(
                "two nodes on input `{}` produce an item `{}`; give each a matrix axis of its own",
                of.port, pair[0].0
            )),
            None => Merged::Whole(Arc::new(Sharded::of(merged))),
        })
    }

    /// Looks actions up; a panic is an answer, too.
    fn look_up(&self, bundle: &LookUps) -> Result<Vec<LookedUp>, CacheError> {
        let lane = bundle.task.lane;
        catch_unwind(AssertUnwindSafe(|| self.find(bundle))).unwrap_or_else(|panic| {
            let message = panicked(&panic);
            let failed = |slot: SlotId| LookedUp::of((lane, slot), Finding::Failed(message.clone()));
            Ok(bundle.actions.iter().map(|action| failed(action.slot)).collect())
        })
    }

    fn find(&self, bundle: &LookUps) -> Result<Vec<LookedUp>, CacheError> {
        let task = &bundle.task;
        let keyed = bundle.actions.iter().map(|of| self.key_of(task, &bundle.whole, of));
        let mut keyed = keyed.collect::<Result<Vec<_>, CacheError>>()?;
        let records = self.recorded(task, &mut keyed)?;
        let borrowed: Vec<Option<&Record>> = records.iter().map(Option::as_deref).collect();
        let made = self.holdings.made_many(&borrowed, &task.producer)?;
        let mut found = borrowed.into_iter().zip(made);
        let looked_up = |(of, key): (&LookUp, Result<Keyed, String>)| {
            let slot: (LaneId, SlotId) = (task.lane, of.slot);
            let (key, hash, file) = match key {
                Ok(found) => found,
                Err(message) => return LookedUp::of(slot, Finding::Failed(message)),
            };
            let digest = file.as_ref().map(Artifact::digest);
            let kept = self.keep_keys.then(|| Box::new(key.clone()));
            let (record, made) = found.next().unwrap_or_default();
            let standing = match made {
                Some(made) if self.dry || task.only_there.is_some() || !self.is_compared(&hash, record, task) => {
                    Finding::Hit(made)
                }
                None if !self.dry && task.only_there.is_some() => Finding::Failed(not_measured(task)),
                None if self.dry => Finding::WouldRun { lost: record.is_some(), gone: self.gone(of) },
                before => Finding::Todo(Box::new(Todo { key, hash, file, before })),
            };
            LookedUp { key: kept, file: digest, ..LookedUp::of(slot, standing) }
        };
        Ok(bundle.actions.iter().zip(keyed).map(looked_up).collect())
    }

    /// The records of actions that have a key. If they run programs, their keys are completed with the files outside
    /// as they are now.
    fn recorded(
        &self,
        task: &Task,
        keyed: &mut [Result<Keyed, String>],
    ) -> Result<Vec<Option<Arc<Record>>>, CacheError> {
        let store = self.holdings.store;
        let keyed: Vec<&mut Keyed> = keyed.iter_mut().filter_map(|of| of.as_mut().ok()).collect();
        if !task.programs {
            let hashes: Vec<Key> = keyed.iter().map(|of| of.1).collect();
            return Ok(store.lookup_many(ACTION, &hashes));
        }
        let keys: Vec<&ActionKey> = keyed.iter().map(|of| &of.0).collect();
        let found = sighted::find_many(store, &keys)?;
        let complete = |(of, found): (&mut Keyed, Sighted)| {
            (of.0, of.1) = (found.key, found.hash);
            found.record
        };
        Ok(keyed.into_iter().zip(found).map(complete).collect())
    }

    /// The inputs of an action of which blobs are not there.
    fn gone(&self, of: &LookUp) -> Vec<InputId> {
        let is_gone = |artifact: &Artifact| artifact.parts.values().any(|digest| !self.holdings.is_here(digest));
        of.each.iter().filter(|(_, output)| is_gone(&output.artifact)).map(|(input, _)| *input).collect()
    }

    /// The key of an action, its hash, and the artifact of the files that it reads; or why it has no key.
    fn key_of(&self, task: &Task, whole: &Whole, of: &LookUp) -> Result<Result<Keyed, String>, CacheError> {
        let derive = || {
            let file = match self.import(of)? {
                Ok(file) => file,
                Err(message) => return Ok(Err(message)),
            };
            let key = action_key(task, whole, of, file.as_ref());
            let hash = key.hash();
            Ok(Ok((key, hash, file)))
        };
        catch_unwind(AssertUnwindSafe(derive)).unwrap_or_else(|panic| Ok(Err(panicked(&panic))))
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

    /// Whether a hit runs again. The sample depends on the keys, and for an audit on the machine: a lab whose machines
    /// all audited the same results would never see the others.
    fn is_compared(&self, hash: &Key, record: Option<&Record>, task: &Task) -> bool {
        let head = u32::from_le_bytes([hash.0[0], hash.0[1], hash.0[2], hash.0[3]]);
        let sampled = |share: f64, salt: u32| f64::from(head ^ salt) < share * f64::from(u32::MAX);
        let is_portable = |record: &Record| Payload::of(record).is_some_and(|p| p.is_portable(&task.producer.spec));
        sampled(self.recheck, 0)
            || sampled(self.audit, self.salt) && record.is_some_and(|of| of.fetched && is_portable(of))
    }
}

/// Why an action does not run that only another machine could measure.
fn not_measured(task: &Task) -> String {
    format!(
        "`{}` did not measure this, or its result is missing; measure it there and push it with `tauflow cache push \
         PIPELINE --all`, or measure everything here: `tauflow run` without --accept-measured",
        task.only_there.as_deref().unwrap_or_default()
    )
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
