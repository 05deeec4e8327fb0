//! `tauflow view`: a page that shows the images of a node's scenes, with all that belongs to them.

mod gallery;

use super::{
    CacheAt, CliError, Exit, PipelineArgs, bytes_text, counted, quoted,
    results::{collection, restore, unread},
    scene::{deliver, is_stream, target},
    tev::Tev,
};
use crate::{
    diagnostics::nearest,
    engine::EngineError,
    ids::{Id, PortId},
    kinds::Registry,
    pipeline::Pipeline,
    query::{Exposures, Family, Reading, Selection},
};
use clap::Args;
use gallery::Gallery;
use std::{
    collections::{BTreeMap, BTreeSet},
    path::{Path, PathBuf},
    sync::atomic::AtomicBool,
};
use tauflow_cache::Store;
use tauflow_contract::{Artifact, Collection, Context, ItemKey, KindError, Media as _, Silent};
use tauflow_data::records::{BridgeSteps, Generated, Ladder, PackedScene, REASONS, Refined, Rollout};
use tauflow_viewer::{Head, ONE_FILE, Page, ViewerError};

/// Arguments of `view`.
#[derive(Args)]
pub(crate) struct ViewArgs {
    #[command(flatten)]
    pipeline: PipelineArgs,
    /// The node: `node`, `node.port`, or `node[axis=value].port`.
    node: String,
    /// One item: a scene, or `cell/scene`. Default: all scenes of the node.
    item: Option<String>,
    /// The page to write. Default: `NODE.html`, or `ITEM.html`. A pipe or device gets a page without a folder.
    #[arg(short, long, value_name = "FILE")]
    out: Option<PathBuf>,
    /// Write the data to a folder beside the page, even if they are small; data beyond 30 MiB always are.
    #[arg(long)]
    folder: bool,
    /// Send the images of the item to the viewer tev at this address, in place of writing a page.
    #[arg(long, value_name = "HOST:PORT", requires = "item", conflicts_with_all = ["out", "folder"])]
    tev: Option<String>,
}

/// Items by scene: one for each cell.
type ByScene = BTreeMap<String, Vec<(ItemKey, Artifact)>>;

/// Which images a viewer shows, and of which scenes.
struct Sources<'a> {
    pipeline: &'a Pipeline,
    family: Family,
    /// The output that was asked for.
    own: (usize, PortId),
    /// Items by output and scene.
    items: BTreeMap<(usize, PortId), ByScene>,
    /// Keys of the scenes.
    scenes: BTreeSet<String>,
}

pub(crate) fn view(args: &ViewArgs, registry: &Registry, cache: &CacheAt) -> Result<Exit, CliError> {
    if args.folder && is_stream(&args.page()) {
        let page = args.page();
        let what = format!("{} is no file, and has no folder beside it; leave --folder out", page.display());
        return Err(CliError::Bad(what));
    }
    let pipeline = args.pipeline.resolve(registry)?;
    let asked = Selection::parse(&args.node, &pipeline)?;
    let store = cache.look()?;
    let sources = Sources::read(args, &asked, &store)?;
    let (reading, stop) = (Reading(&store), AtomicBool::new(false));
    let ctx = Context::new(&reading, &Silent, &stop);
    let exposures = sources.exposures(&ctx, &store)?;
    let mut restored = BTreeSet::new();
    loop {
        let gallery = Gallery::new(&ctx, &sources, &exposures);
        let done = match &args.tev {
            Some(address) => send(gallery, address),
            None => write(gallery, args, &sources, cache),
        };
        match done {
            Ok(()) => return Ok(Exit::Done),
            Err(Failure::Lost(output)) if restored.insert(output) => {
                restore(&sources.selection(output)?, &store)?;
            }
            Err(Failure::Lost((node, _))) => {
                return Err(unread(&pipeline.nodes[node].name, KindError::Internal("it is lost again".into())));
            }
            Err(Failure::Error(error)) => return Err(error),
        }
    }
}

/// Why a page was not written.
enum Failure {
    /// Blobs of an output are missing or damaged.
    Lost((usize, PortId)),
    Error(CliError),
}

impl From<CliError> for Failure {
    fn from(error: CliError) -> Self {
        Self::Error(error)
    }
}

impl<'a> Sources<'a> {
    /// Finds the items of the family. The node itself must be up to date; whatever else is not is left out, which is
    /// told.
    fn read(args: &ViewArgs, asked: &Selection<'a>, store: &Store) -> Result<Self, CliError> {
        let (pipeline, own) = (asked.pipeline(), (asked.node, asked.port));
        let family = Family::of(asked);
        let found = collection(asked, store)?;
        let scenes = chosen(args, &found)?;
        let mut sources = Self { pipeline, family, own, items: BTreeMap::new(), scenes };
        let outputs: BTreeSet<_> = sources.family.outputs().filter(|output| *output != own).collect();
        for output in outputs {
            match sources.selection(output)?.collection(store) {
                Ok(items) => drop(sources.items.insert(output, by_scene(&items, &sources.scenes))),
                Err(EngineError::Request(_) | EngineError::Lost(_)) => {
                    errln!("`{}` is not up to date; the viewer leaves it out", sources.name(output));
                }
                Err(error) => return Err(error.into()),
            }
        }
        sources.items.insert(own, by_scene(&found, &sources.scenes));
        Ok(sources)
    }

    /// The name of an output: `node.port`.
    fn name(&self, (node, port): (usize, PortId)) -> String {
        let node = &self.pipeline.nodes[node];
        format!("{}.{}", node.name, node.spec.outputs[port.place()].name)
    }

    fn selection(&self, output: (usize, PortId)) -> Result<Selection<'a>, CliError> {
        Ok(Selection::parse(&self.name(output), self.pipeline)?)
    }

    /// The items of an output of a scene: one for each cell.
    fn of_scene(&self, output: (usize, PortId), scene: &str) -> &[(ItemKey, Artifact)] {
        self.items.get(&output).and_then(|items| items.get(scene)).map_or(&[], Vec::as_slice)
    }

    /// The exposures of the packed scenes.
    fn exposures(&self, ctx: &Context<'_>, store: &Store) -> Result<Vec<Exposures>, CliError> {
        let of = |output: &(usize, PortId)| {
            // Exposures that are not there are unknown.
            Ok(Exposures::of(&self.selection(*output)?, ctx, &|other| other.collection(store).ok()))
        };
        self.family.packed.iter().map(of).collect()
    }
}

/// Items by scene, of the scenes that are wanted.
fn by_scene(items: &Collection, scenes: &BTreeSet<String>) -> ByScene {
    let mut found = ByScene::new();
    for (key, artifact) in items.iter().filter(|(key, _)| scenes.contains(scene_of(key))) {
        found.entry(scene_of(key).to_owned()).or_default().push((key.clone(), artifact.clone()));
    }
    found
}

/// The scene of an item: the last part of its key.
fn scene_of(key: &ItemKey) -> &str {
    key.split_cell().map_or(key.as_str(), |(_, own)| own)
}

/// The scenes that are asked for.
fn chosen(args: &ViewArgs, found: &Collection) -> Result<BTreeSet<String>, CliError> {
    let all: BTreeSet<String> = found.iter().map(|(key, _)| scene_of(key).to_owned()).collect();
    let Some(item) = &args.item else {
        return if all.is_empty() { Err(CliError::Bad(format!("`{}` has no items", args.node))) } else { Ok(all) };
    };
    let named = found.iter().find(|(key, _)| key.as_str() == item || scene_of(key) == item);
    match named {
        Some((key, _)) => Ok(BTreeSet::from([scene_of(key).to_owned()])),
        None => {
            let hint = nearest(item, all.iter().map(String::as_str)).map_or_else(
                || {
                    format!(
                        "it has {}, such as `{}`",
                        counted(all.len() as u64, "scene"),
                        all.iter().next().map_or("", String::as_str)
                    )
                },
                |near| format!("did you mean `{near}`?"),
            );
            Err(CliError::Bad(format!("`{}` has no item `{item}`; {hint}", args.node)))
        }
    }
}

impl ViewArgs {
    /// The page's file.
    fn page(&self) -> PathBuf {
        self.out.clone().unwrap_or_else(|| {
            let plain = |c: char| if c.is_ascii_alphanumeric() || "._-".contains(c) { c } else { '-' };
            let name: String = self.item.as_ref().unwrap_or(&self.node).chars().map(plain).collect();
            PathBuf::from(format!("{name}.html"))
        })
    }

    /// The command that makes the page again.
    fn again(&self, cache: &CacheAt, page: &Path) -> String {
        let item = self.item.iter().map(|item| format!(" {}", quoted(item))).collect::<String>();
        let folder = if self.folder { " --folder" } else { "" };
        let (pipeline, node) = (self.pipeline.again(), quoted(&self.node));
        format!(
            "tauflow view {pipeline} {node}{item} -o {}{folder}{}",
            quoted(&page.display().to_string()),
            cache.again()
        )
    }
}

/// Writes the page, scene by scene.
fn write(mut gallery: Gallery<'_>, args: &ViewArgs, sources: &Sources<'_>, cache: &CacheAt) -> Result<(), Failure> {
    let path = args.page();
    let failed = |error: ViewerError| match error {
        ViewerError::Io { .. } => CliError::Environment(error.to_string()),
        ViewerError::Image { .. } => CliError::Bad(error.to_string()),
    };
    let stream = is_stream(&path);
    let mut page = if stream { Page::in_memory() } else { Page::new(target(&path), args.folder.then_some(0)) };
    for scene in &sources.scenes {
        let scene = gallery.scene(scene)?;
        page.add(scene, gallery.frames(), gallery.tracks()).map_err(failed)?;
        if stream && page.bytes() > ONE_FILE {
            let (path, most) = (path.display(), bytes_text(ONE_FILE as u64));
            let what =
                format!("data beyond {most} need a folder, which {path} cannot have; name a file with -o, or one ITEM");
            return Err(CliError::Bad(what).into());
        }
    }
    let (frames, tracks) = gallery.finished();
    if frames.is_empty() {
        return Err(CliError::Bad(no_images(args, sources)).into());
    }
    let version = env!("CARGO_PKG_VERSION");
    let head = Head {
        title: format!("{}, {}", sources.pipeline.name, args.node),
        provenance: format!("tauflow {version}. Made by:"),
        command: args.again(cache, &path),
        first: gallery.first(),
        reasons: REASONS.iter().map(|(name, text)| ((*name).to_owned(), (*text).to_owned())).collect(),
    };
    if stream {
        // It may be stdout itself, and gets the page alone.
        let text = page.text(&head, &frames, &tracks).map_err(failed)?;
        deliver(&path, text.as_bytes())?;
        errln!("{}, {}", counted(sources.scenes.len() as u64, "scene"), bytes_text(text.len() as u64));
        return Ok(());
    }
    let written = page.finish(&head, &frames, &tracks).map_err(failed)?;
    let folder = written.folder.as_ref().map_or_else(String::new, |folder| format!(", with {}", folder.display()));
    errln!("{}, {}{folder}", counted(written.scenes as u64, "scene"), bytes_text(written.bytes));
    outln!("{}", path.display());
    Ok(())
}

/// Sends the images of the only scene to tev.
fn send(mut gallery: Gallery<'_>, address: &str) -> Result<(), Failure> {
    let scenes = gallery.scenes();
    for scene in scenes {
        let scene = gallery.scene(&scene)?;
        for (frame, image) in &scene.images {
            let name = format!("{}/{}", scene.key, gallery.frames()[*frame].id);
            let mut tev = Tev::connect(address, &name, (image.width(), image.height()))?;
            tev.show(image)?;
        }
        errln!("{} sent", counted(scene.images.len() as u64, "image"));
    }
    Ok(())
}

/// The error of a node without images, with nodes that have some.
fn no_images(args: &ViewArgs, sources: &Sources<'_>) -> String {
    let pictures = [Ladder::NAME, PackedScene::NAME, Refined::NAME, Rollout::NAME, BridgeSteps::NAME, Generated::NAME];
    let pipeline = sources.pipeline;
    let name = |at: usize| {
        let node = &pipeline.nodes[at];
        let has = node.spec.outputs.first().is_some_and(|port| pictures.contains(&port.media));
        has.then(|| format!("`{}`", node.name))
    };
    let read: Vec<String> = pipeline.reads(sources.own.0).into_iter().filter_map(name).collect();
    let others = match read.as_slice() {
        [] => {
            let names: Vec<String> = (0..pipeline.nodes.len()).filter_map(name).take(8).collect();
            if names.is_empty() { String::new() } else { format!("; name a node with images: {}", names.join(", ")) }
        }
        read => format!("; name a node that it reads: {}", read.join(", ")),
    };
    format!("the items of `{}` have no images of scenes{others}", args.node)
}
