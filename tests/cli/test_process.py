"""The command as a process: signals, closed streams, locales, what it imports."""

from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
import sys
import tempfile
from pathlib import Path

import pytest

from beamseg_batch import accelerate, read_run
from tests.cli.conftest import LIGHT

COMMAND = (sys.executable, "-m", "beamseg_batch")
INTERRUPTED = 130
FULL = Path("/dev/full")
SAMPLE = Path(__file__).parents[2] / "data" / "samples" / "arena.mcap"

# Ctrl-C as the user gives it: a signal to the process, after a given number of clouds.
INTERRUPTING = """
import os, signal, sys
from beamseg_batch.cli.console import ScanProgress
from beamseg_batch.cli.main import main

clouds, signals = int(sys.argv.pop(1)), int(sys.argv.pop(1))

def step(self, n_segments):
    global clouds
    clouds -= 1
    if clouds == 0:
        for _ in range(signals):
            os.kill(os.getpid(), signal.SIGINT)

ScanProgress.step = step
main()
"""


# A worker process is killed after a given number of clouds.
KILLING = INTERRUPTING.replace(
    "os.kill(os.getpid(), signal.SIGINT)", "multiprocessing.active_children()[0].kill()"
).replace("import os, signal", "import multiprocessing")


def run(*arguments, **options) -> subprocess.CompletedProcess[str]:
    options = {"capture_output": True, "text": True, "encoding": "utf-8", "timeout": 300, **options}
    finished = subprocess.run([str(a) for a in arguments], check=False, **options)
    for text in (finished.stdout, finished.stderr):
        assert not text or "Traceback" not in text, text
    return finished


def through_shell(redirection: str, *arguments) -> subprocess.CompletedProcess[str]:
    return run("sh", "-c", f'exec "$@" {redirection}', "sh", *COMMAND, *arguments)


def with_reader_gone(*arguments) -> tuple[int, str]:
    """Run with a stdout that nobody reads."""
    read_end, write_end = os.pipe()
    os.close(read_end)
    try:
        finished = run(
            *COMMAND, *arguments, stdout=write_end, stderr=subprocess.PIPE, capture_output=False
        )
    finally:
        os.close(write_end)
    return finished.returncode, finished.stderr


# Ctrl-C


def test_interrupt__leaves_what_is_known(flight, here):
    done = run(sys.executable, "-c", INTERRUPTING, 3, 1, "run", flight, "-o", "out")
    assert done.returncode == INTERRUPTED
    assert "beamseg: stopping after this scan; press Ctrl-C again to stop at once" in done.stderr
    assert done.stderr.count("interrupted after 3 of 6 clouds") == 1
    assert "out.partial" in done.stderr
    assert [path.name for path in here.iterdir()] == ["out.partial"]
    partial = read_run(here / "out.partial")
    assert partial.summary["interrupted"] is True
    assert partial.summary["counts"]["processed"] == 3
    assert len(partial.columns["processing_time"]["wall_time"]) == 3
    assert len(partial.segments) == 1
    assert set(partial.summary["files"]) == {path.name for path in partial.folder.iterdir()}


def test_interrupt__twice_stops_at_once(flight, here):
    done = run(sys.executable, "-c", INTERRUPTING, 3, 2, "run", flight, "-o", "out", *LIGHT)
    assert done.returncode == INTERRUPTED
    assert done.stdout == ""
    assert done.stderr.splitlines()[-1] == "beamseg: interrupted"
    assert list(here.iterdir()) == []


def test_interrupt__before_any_cloud_could_be_used(flight, here):
    late = ("--set", "recording.time_offset_s=-0.25")  # so that the first clouds have no pose
    done = run(sys.executable, "-c", INTERRUPTING, 1, 1, "run", flight, "-o", "out", *late, *LIGHT)
    assert done.returncode == INTERRUPTED
    assert "scans          0 used, 1 skipped" in done.stdout
    assert read_run(here / "out.partial").segments == ()


def test_interrupt__keeps_an_earlier_run(ok, flight, here):
    ok("run", flight, "-o", "out")
    before = (here / "out" / "summary.json").read_bytes()
    arguments = ("run", flight, "-o", "out", "--overwrite", *LIGHT)
    for _ in range(2):
        done = run(sys.executable, "-c", INTERRUPTING, 2, 1, *arguments)
        assert done.returncode == INTERRUPTED
    assert (here / "out" / "summary.json").read_bytes() == before
    assert read_run(here / "out.partial").summary["counts"]["processed"] == 2


def test_interrupt__json_is_all_there_is_on_stdout(flight, here):
    arguments = ("run", flight, "-o", "out", "--json", *LIGHT)
    done = run(sys.executable, "-c", INTERRUPTING, 2, 1, *arguments)
    assert done.returncode == INTERRUPTED
    assert json.loads(done.stdout)["interrupted"] is True


@pytest.mark.parametrize("jobs", [2, 3])
def test_interrupt__leaves_what_is_known_with_several_jobs(flight, here, jobs):
    arguments = ("run", flight, "-o", "out", "-j", jobs, *LIGHT)
    done = run(sys.executable, "-c", INTERRUPTING, 3, 1, *arguments)
    assert done.returncode == INTERRUPTED
    assert done.stderr.count("interrupted after 3 of 6 clouds") == 1
    assert read_run(here / "out.partial").summary["counts"]["processed"] == 3


def test_interrupt__twice_stops_at_once_with_several_jobs(flight, here):
    arguments = ("run", flight, "-o", "out", "-j", 2, *LIGHT)
    done = run(sys.executable, "-c", INTERRUPTING, 3, 2, *arguments)
    assert done.returncode == INTERRUPTED
    assert done.stderr.splitlines()[-1] == "beamseg: interrupted"
    assert list(here.iterdir()) == []


# A worker that ends


@pytest.mark.parametrize(("profile", "clouds"), [("report", 3), ("precise", 110)])
def test_dead_worker__leaves_what_is_known(here, profile, clouds):
    arguments = ("run", SAMPLE, "-o", "out", "-j", 2, "--profile", profile, *LIGHT)
    done = run(sys.executable, "-c", KILLING, clouds, 1, *arguments, timeout=60)
    assert done.returncode == 1
    assert "of 2 ended unexpectedly, killed by signal SIGKILL" in done.stderr.splitlines()[-1]
    assert [path.name for path in here.iterdir()] == ["out.partial"]
    assert read_run(here / "out.partial").summary["interrupted"] is True


def test_killed__leaves_no_process(here):
    """Nobody holds the other end of its stderr any more, else this would not end."""
    killed = INTERRUPTING.replace("SIGINT", "SIGKILL")
    arguments = ("run", SAMPLE, "-o", "out", "-j", 2, *LIGHT)
    done = run(sys.executable, "-c", killed, 3, 1, *arguments, timeout=60)
    assert done.returncode == -signal.SIGKILL
    assert list(here.iterdir()) == []


def test_interrupt__while_reading(flight, here):
    program = (
        "import os, signal\n"
        "import beamseg_batch.recording\n"
        "signal.signal(signal.SIGINT, signal.default_int_handler)\n"
        "def interrupted(*_):\n"
        "    os.kill(os.getpid(), signal.SIGINT)\n"
        "beamseg_batch.recording.open_recording = interrupted\n"
        "from beamseg_batch.cli.main import main\n"
        "main()\n"
    )
    done = run(sys.executable, "-c", program, "info", flight)
    assert (done.returncode, done.stdout) == (INTERRUPTED, "")
    assert done.stderr == "beamseg: interrupted\n"


def test_interrupt__also_where_a_script_started_it_in_the_background(flight, here):
    """There it inherits an ignored SIGINT, and `kill -INT` shall stop it all the same."""
    command = (sys.executable, "-c", INTERRUPTING, 3, 1, "run", flight, "-o", "out", *LIGHT)
    done = run("sh", "-c", "trap '' INT; exec \"$@\"", "sh", *command)
    assert done.returncode == INTERRUPTED
    assert read_run(here / "out.partial").summary["counts"]["processed"] == 3


# Streams


@pytest.mark.parametrize("arguments", [["--help"], ["config", "schema"], ["config", "show"]])
def test_stdout__reader_has_gone(arguments):
    assert with_reader_gone(*arguments) == (1, "")


def test_stdout__reader_of_a_run_has_gone(flight, here):
    _, errors = with_reader_gone("run", flight, "-o", "out", *LIGHT)
    assert [line.split(" ", 2)[1] for line in errors.splitlines()] == ["reading", "the", "the"]
    assert read_run(here / "out").summary["interrupted"] is False


@pytest.mark.skipif(not FULL.exists(), reason="needs /dev/full")
@pytest.mark.parametrize("arguments", [["config", "schema"], ["config", "show", "--json"]])
def test_stdout__disk_is_full(arguments):
    done = through_shell(">/dev/full", *arguments)
    assert done.returncode == 2
    assert done.stderr.startswith("beamseg: error: stdout: cannot be written: ")
    assert done.stderr.count("\n") == 1


@pytest.mark.skipif(not FULL.exists(), reason="needs /dev/full")
def test_stderr__disk_is_full(flight, here):
    assert through_shell("2>/dev/full", "run", flight, "-o", "out", *LIGHT).returncode == 0
    assert through_shell("2>/dev/full", "run", "nix").returncode == 2


def test_streams__all_closed(flight, here):
    assert through_shell("<&- >&- 2>&-", "run", flight, "-o", "out", *LIGHT).returncode == 0
    assert len(read_run(here / "out").segments) == 1


# Surroundings


def test_locale__plain_ascii(flight, here):
    recording = here / "Übung №1.mcap"
    recording.write_bytes(flight.read_bytes())
    surroundings = {
        **os.environ,
        "LC_ALL": "POSIX",
        "PYTHONUTF8": "0",
        "PYTHONCOERCECLOCALE": "0",
        "PYTHONIOENCODING": "ascii:strict",
    }
    done = run(*COMMAND, "run", recording.name, "-o", "größe", env=surroundings)
    assert done.returncode == 0, done.stderr
    assert read_run(here / "größe").summary["counts"]["processed"] == 6
    assert run(*COMMAND, "info", recording.name, env=surroundings).returncode == 0
    assert run(*COMMAND, "run", "ü.mcap", env=surroundings).returncode == 2


@pytest.mark.skipif(sys.platform != "linux", reason="needs file names of any bytes")
def test_locale__file_name_that_is_no_text(flight, here):
    name = b"flight\xff.mcap"
    Path(os.fsdecode(name)).write_bytes(flight.read_bytes())
    strict = {**os.environ, "PYTHONIOENCODING": "utf-8:strict"}
    done = run(*COMMAND, "run", os.fsdecode(name), "-o", "out", *LIGHT, env=strict)
    assert done.returncode == 0, done.stderr
    assert r"flight\udcff.mcap" in done.stderr
    done = run(*COMMAND, "info", os.fsdecode(name), env=strict)
    assert r"flight\udcff.mcap" in done.stdout


def test_home__cannot_be_written(flight, here, tmp_path_factory, monkeypatch):
    temporary = tmp_path_factory.mktemp("temporary")
    monkeypatch.setattr(tempfile, "tempdir", str(temporary))
    # Compiled before, as it is from the second run on.
    shutil.copytree(accelerate.cache_folder(), accelerate._temporary_cache(), dirs_exist_ok=True)
    nowhere = dict.fromkeys(("HOME", "XDG_CACHE_HOME"), "/dev/null/none")
    surroundings = {**os.environ, **nowhere, "TMPDIR": str(temporary), "NUMBA_CACHE_DIR": ""}
    done = run(*COMMAND, "run", flight, "-o", "out", *LIGHT, env=surroundings)
    assert done.returncode == 0, done.stderr


def test_working_folder__is_gone(flight, tmp_path):
    gone = tmp_path / "gone"
    script = 'mkdir "$0" && cd "$0" && rmdir "$0" && exec "$@"'
    done = run("sh", "-c", script, gone, *COMMAND, "run", flight)
    assert done.returncode != 0
    assert done.stderr.startswith("beamseg: error: ")
    assert done.stderr.count("\n") == 1


def test_version__is_printed():
    done = run(*COMMAND, "--version")
    assert done.returncode == 0
    assert done.stdout.startswith("beamseg ")


@pytest.mark.parametrize(
    "arguments",
    [
        ["--help"],
        ["run", "--help"],
        ["info", "-h"],
        ["config", "show", "--help"],
        ["export", "--help"],
        ["view", "--help"],
    ],
)
def test_help__imports_no_heavy_library(arguments):
    program = (
        "import json, sys\n"
        "from beamseg_batch.cli.main import beamseg\n"
        f"beamseg({arguments!r}, standalone_mode=False)\n"
        "print(json.dumps(sorted({name.partition('.')[0] for name in sys.modules})))\n"
    )
    modules = set(json.loads(run(sys.executable, "-c", program).stdout.splitlines()[-1]))
    heavy = {"numba", "numpy", "open3d", "pandas", "plotly", "pydantic", "rich", "rosbags", "scipy"}
    assert not modules & heavy
