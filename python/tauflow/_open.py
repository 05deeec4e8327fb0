"""Opens exports, folders of results, and pipelines with their cache."""

from __future__ import annotations

import json
import os
import shlex
import shutil
import subprocess
import sys
import tempfile
from typing import TYPE_CHECKING, Any, Dict, Iterable, Iterator, List, Mapping, Optional, Union

from ._errors import Missing, TauflowError
from ._items import Node, read_json
from ._tables import read_rows, typed

if TYPE_CHECKING:
    import pandas as pd


def program() -> str:
    """The `tauflow` command: $TAUFLOW, the one that was installed with this package, or the one in PATH.

    Raises TauflowError if there is none.
    """
    named = os.environ.get("TAUFLOW")
    if named:
        return named
    beside = os.path.join(os.path.dirname(sys.executable), "tauflow")
    found = beside if os.access(beside, os.X_OK) else shutil.which("tauflow")
    if not found:
        raise TauflowError("there is no `tauflow` command; install it, or name it in the variable TAUFLOW")
    return found


def _run(words: List[str]) -> str:
    try:
        done = subprocess.run([program(), *words], capture_output=True, text=True, check=False)
    except OSError as error:
        raise TauflowError(f"{program()}: {error}") from None
    if done.returncode:
        told = done.stderr.strip().removeprefix("error: ")
        raise TauflowError(told or f"`tauflow {' '.join(words)}` failed with {done.returncode}")
    return done.stdout


class Pipeline:
    """The results of a pipeline in its cache. Nodes are exported to a temporary folder when they are first read."""

    def __init__(
        self,
        file: str,
        profile: Optional[str] = None,
        set: Iterable[str] = (),
        cache: Optional[str] = None,
        raw: bool = False,
    ):
        self.file = file
        self._options = [*(["--profile", profile] if profile else []), *(w for s in set for w in ("--set", s))]
        self._cache = ["--cache", cache] if cache else []
        self._raw = ["--raw"] if raw else []
        self._folder = tempfile.TemporaryDirectory(prefix="tauflow-")
        self._nodes: Dict[str, Node] = {}

    def __getitem__(self, node: str) -> Node:
        """The items of a node: `node`, `node.port`, or `node[axis=value].port`.

        Raises TauflowError if there is no such node, or it is not up to date; the message says what to run.
        """
        if node not in self._nodes:
            folder = os.path.join(self._folder.name, str(len(self._nodes)))
            words = ["export", self.file, node, "-o", folder, *self._raw, *self._options, *self._cache]
            try:
                _run(words)
            except TauflowError as error:
                if "must run first" not in str(error):
                    raise
                options = [*self._options, *self._cache, "--target", node.split("[")[0]]
                again = shlex.join(["tauflow", "run", self.file, *options])
                raise TauflowError(f"{error}. Command: {again}") from None
            self._nodes[node] = Node(folder, "open the pipeline again", self._folder)
        return self._nodes[node]

    #: Its nodes are not listed.
    __iter__ = None

    def __repr__(self) -> str:
        return f"<Pipeline {' '.join([self.file, *self._options])}>"


class Results:
    """A folder of results, `out/<pipeline>`: its tables and pictures, and the nodes of the run that made it."""

    def __init__(self, folder: str, summary: Mapping[str, Any], cache: Optional[str], raw: bool):
        self.folder, self.summary = folder, dict(summary)
        #: Name of the pipeline.
        self.name: str = summary.get("pipeline", os.path.basename(os.path.abspath(folder)))
        self._cache, self._raw = cache, raw
        self._pipeline: Optional[Pipeline] = None

    @property
    def files(self) -> List[str]:
        """Names of its files, those in folders as `folder/name`."""
        found: List[str] = []
        for folder, _, names in os.walk(self.folder):
            inside = os.path.relpath(folder, self.folder).split(os.sep)
            found.extend("/".join([*(part for part in inside if part != "."), name]) for name in names)
        return sorted(found)

    def path(self, name: str) -> str:
        """Path of a file. The folder may be left out where one file has the name.

        Raises TauflowError if there is no such file, or several.
        """
        files = self.files
        found = [name] if name in files else [file for file in files if file.endswith(f"/{name}")]
        if len(found) > 1:
            raise TauflowError(f"{self.folder}: `{name}` is in several folders; name one of {', '.join(found)}")
        if not found:
            raise TauflowError(f"{self.folder} has no file `{name}`; it has {', '.join(files)}")
        return os.path.join(self.folder, *found[0].split("/"))

    def rows(self, table: str) -> List[Dict[str, Any]]:
        """The rows of a CSV table, numbers as numbers."""
        return read_rows(self.path(table if table.endswith(".csv") else table + ".csv"))

    def frame(self, table: str) -> pd.DataFrame:
        """A CSV table as a pandas DataFrame."""
        return typed(self.rows(table))

    @property
    def pipeline(self) -> Pipeline:
        """The pipeline of the run that wrote these results, with its profile and overrides."""
        if self._pipeline is None:
            wanted = self.summary.get("run")
            last = "100000" if wanted else "1"
            words = ["runs", self.name, "--json", "--last", last, *(["--cache", self._cache] if self._cache else [])]
            try:
                lines = _run(words).splitlines()
            except TauflowError as error:
                hint = "" if self._cache else "; give the cache of the run, as in tauflow.open(..., cache=...)"
                raise TauflowError(f"{error}{hint}") from None
            if not lines:
                raise TauflowError(f"no run of `{self.name}` is recorded in the cache; open the pipeline file instead")
            runs = [json.loads(line) for line in lines]
            own = [run for run in runs if wanted in (None, run["id"])]
            if not own:
                told = f"run {wanted}, which wrote {self.folder}, is not recorded in the cache any more"
                raise TauflowError(f"{told}; open the pipeline file instead, or run it again")
            self._pipeline = _pipeline_of(own[-1], self._cache, self._raw)
        return self._pipeline

    def __getitem__(self, node: str) -> Node:
        """The items of a node of the run (see `Pipeline`)."""
        return self.pipeline[node]

    def __iter__(self) -> Iterator[str]:
        return (node["node"] for node in self.summary.get("nodes", []))

    def __repr__(self) -> str:
        return f"<Results {self.folder}: {len(self.files)} files, {len(list(self))} nodes>"


def _pipeline_of(run: Mapping[str, Any], cache: Optional[str], raw: bool) -> Pipeline:
    """The pipeline of a recorded run, with its profile and overrides."""
    pipeline = Pipeline(run["file"], cache=cache, raw=raw)
    # A record has options as they were given, such as `--profile tiny`.
    pipeline._options = [word for given in run.get("overrides", []) for word in given.split(" ", 1)]
    return pipeline


class Cache(Mapping[str, Pipeline]):
    """A cache: the pipelines that ran in it, by name, each as its latest recorded run had it."""

    def __init__(self, folder: str, raw: bool = False):
        self.folder, self._raw = folder, raw
        self._latest: Optional[Dict[str, Dict[str, Any]]] = None
        self._pipelines: Dict[str, Pipeline] = {}

    @property
    def runs(self) -> Dict[str, Dict[str, Any]]:
        """The record of the latest run of each pipeline, by its name."""
        if self._latest is None:
            lines = _run(["runs", "--json", "--last", "100000", "--cache", self.folder]).splitlines()
            records = [json.loads(line) for line in lines]
            records.sort(key=lambda run: (run["started"], run["id"]))
            self._latest = {run["pipeline"]: run for run in records}
        return self._latest

    def __getitem__(self, name: str) -> Pipeline:
        """The pipeline of this name. Raises TauflowError if no run of it is recorded in the cache."""
        if name not in self._pipelines:
            if name not in self.runs:
                have = ", ".join(self.runs) or "none"
                raise Missing(f"{self.folder}: no run of `{name}` is recorded in this cache; it has {have}")
            self._pipelines[name] = _pipeline_of(self.runs[name], self.folder, self._raw)
        return self._pipelines[name]

    def __contains__(self, name: object) -> bool:
        return name in self.runs

    def __iter__(self) -> Iterator[str]:
        return iter(self.runs)

    def __len__(self) -> int:
        return len(self.runs)

    def __repr__(self) -> str:
        return f"<Cache {self.folder}: {', '.join(self) or 'no runs'}>"


def open(
    path: Union[str, os.PathLike],
    *,
    profile: Optional[str] = None,
    set: Iterable[str] = (),
    cache: Optional[Union[str, os.PathLike]] = None,
    raw: bool = False,
) -> Union[Node, Results, Pipeline, Cache]:
    """Opens results.

    - A folder that `tauflow export` wrote: its items, a `Node`.
    - A folder of results such as `out/quickstart`: `Results`.
    - A pipeline file: `Pipeline`, with `profile` and `set` as on the command line.
    - A folder that is a cache: `Cache`, the pipelines that ran in it.

    `cache` is the cache folder, by default that of the command. `raw` gives all images as raw radiance.
    Raises TauflowError for anything else, and for what is damaged.
    """
    path = os.fspath(path)
    cache = None if cache is None else os.fspath(cache)
    if os.path.isfile(path):
        return Pipeline(path, profile, set, cache, raw)
    if not os.path.isdir(path):
        raise TauflowError(f"{path}: there is no such file or folder")
    if os.path.isfile(os.path.join(path, "manifest.json")):
        return Node(path, "export it again")
    if os.path.isfile(os.path.join(path, "run.json")):
        return Results(path, read_json(os.path.join(path, "run.json")), cache, raw)
    if os.path.isfile(os.path.join(path, "FORMAT")) and os.path.isfile(os.path.join(path, "CACHEDIR.TAG")):
        return Cache(path, raw)
    raise TauflowError(
        f"{path}: this is neither an export (it has no `manifest.json`) nor a folder of results (no `run.json`) nor a "
        "cache (no `CACHEDIR.TAG`)"
    )
