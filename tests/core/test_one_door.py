"""What others may have written is read through `wcsim.core.reading` alone; who reads beside it says why he may."""

import ast

from tests.support.tracked import parsed

READERS = {
    *("read_text", "read_bytes", "open", "GzipFile", "ZipFile", "decompress", "decompressobj", "BZ2Decompressor"),
    *("ZstdDecompressor", "fromstring", "ParserCreate", "XMLParser", "loadtxt", "genfromtxt", "fromfile", "memmap"),
    *("read_array", "load_file", "safe_open"),
}
FROM = {
    ("json", "loads"),
    ("json", "load"),
    ("tomllib", "loads"),
    ("tomllib", "load"),
    ("csv", "reader"),
    ("np", "load"),
}
FROM |= {("ElementTree", "parse"), ("json", "decode"), ("msgpack", "decode"), ("csv", "DictReader"), ("", "load")}
WRITES = ("'w'", "'wb'", "'a'", "'ab'", "'x'", "'xb'", "O_WRONLY", "O_CREAT", "O_DIRECTORY")
OPENERS = {"machines", "self._hands", "video", "memory", "self._writer"}  # of other things than files
BESIDE = {
    "its own process or child made it": (
        "bridge/sumo/session.py", "bridge/sumo/warm_state.py",
        "agents/evaluation/suite/run.py", "agents/export/footprint.py", "cli/training/demo.py", "scenes/run.py",
        "server/launch/event_log.py", "server/launch/supervised.py", "core/processes.py",
        "server/workers/ray_workers.py", "server/workers/cluster_node.py", "towns/importing/folder_texts.py",
        "towns/osm/read.py", "towns/pave/pavements.py", "towns/scenario/options.py", "towns/scenario/stage.py",
        "bridge/sumo/open_scenario.py", "towns/checks/cures.py", "towns/importing/importer.py",
        "towns/scene_folders/build.py", "towns/sumo/warning_log.py", "drive/playing/tick_film.py",
        "agents/evaluation/suite/result_files.py",
    ),
    "it belongs to wcsim": (
        "config/load.py", "core/sources.py", "drive/serving/server.py", "towns/importing/demand.py", "towns/street.py",
    ),
    "the system says it": (
        "log/fingerprint.py", "log/reader.py", "server/specs.py", "server/host/process.py", "cli/main.py",
        "bridge/world_copy.py",
    ),
    "a lock or a folder, of which nothing is read": ("log/writer.py", "core/own_folder.py"),
    "the door gave the bytes": (
        "agents/runs/checkpoint.py", "agents/runs/data_folder.py", "agents/runs/metrics.py", "agents/runs/weights.py",
        "chair_check/stick_drives.py", "drive/recording/study_plan.py", "users/recordings/recorded_user.py",
        "towns/sumo/xml_io.py", "log/framing.py", "server/links/socket.py", "server/protocol/messages.py",
    ),
    "an unpacker that the door uses again and again": (
        "agents/danger/dataset.py", "agents/learning/replay/frame_store.py", "towns/ground/tiles.py",
    ),
    "a cache of this user's, whose hashes are checked": ("core/files.py", "towns/cache/street_cache.py"),
}  # fmt: skip


def reads(tree: ast.AST) -> list[str]:
    """The calls of a module that read."""
    found = []
    for call in ast.walk(tree):
        if not isinstance(call, ast.Call):
            continue
        of, _, name = ast.unparse(call.func).rpartition(".")
        door = (not of and name in ("read_text", "read_bytes")) or of == "reading" or of in OPENERS
        reader = name in READERS or (of.rpartition(".")[2], name) in FROM
        if reader and not door and not any(word in ast.unparse(call) for word in WRITES):
            found.append(ast.unparse(call))
    return found


def test_a_reader_is_seen() -> None:
    for line in ("open(path)", "path.read_text()", "os.open(path, flags)", "json.loads(text)", "np.load(path)"):
        assert reads(ast.parse(line)) == [line]
    assert reads(ast.parse("path.open('wb'); read_bytes(path, KIND); video.open(name)")) == []


def test_nothing_is_read_beside_the_door() -> None:
    found = {file.removeprefix("wcsim/") for file, tree in parsed("wcsim").items() if reads(tree)} - {"core/reading.py"}
    named = {name for names in BESIDE.values() for name in names}
    assert found - named == set(), "read it through wcsim.core.reading, or say here why not"
    assert named - found == set(), "reads nothing any more"
