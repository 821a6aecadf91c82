"""The command line as a whole: help, errors in one line, exit codes."""

import ast
import os
import subprocess
import sys
from pathlib import Path

import click
import pytest
from click.shell_completion import ShellComplete

from webapp import errors
from webapp.app import main as program
from webapp.cli.exitcodes import exit_code
from webapp.connect import connections

COMMANDS = [
    "sample", "map", "map check", "map from-photos", "map place-rest", "build", "localize", "find",
    "evaluate", "landmarks", "landmarks build", "models", "models list", "models fetch", "models check",
    "serve", "worker",
    "mission", "mission list", "mission new", "mission import", "mission inspect", "mission export",
    "robot", "robot send", "robot replay", "robot recover", "robot status",
    "foxglove", "foxglove localize", "foxglove mission",
    "connect", *(f"connect {name}" for name in connections()),
    "account", "account link", "account token", "account add", "account list",
    "settings", "doctor", "backup", "restore", "library", "library move", "cluster", "cluster demo",
]  # fmt: skip


@pytest.fixture
def expmap(capsys):
    """Run the command in this process and return exit code, standard output and standard error."""

    def call(*arguments):
        with pytest.raises(SystemExit) as ended:
            program.main([str(a) for a in arguments])
        output = capsys.readouterr()
        return ended.value.code, output.out, output.err

    return call


def run(*arguments, **options):
    """Run the command in a separate process."""
    words = [sys.executable, *arguments]
    return subprocess.run(words, capture_output=True, text=True, timeout=300, **options)


@pytest.mark.parametrize("command", ["", *COMMANDS])
def test_help_of_every_command(expmap, command):
    code, out, err = expmap(*command.split(), "--help")
    assert (code, err) == (0, "")
    assert out.startswith(f"Usage: expmap {command}".rstrip())
    assert expmap(*command.split(), "-h") == (0, out, "")


def test_the_list_of_commands_is_complete(expmap):
    assert [c for c in COMMANDS if " " not in c] == list(
        program.root.list_commands(click.Context(program.root))
    )
    _, out, _ = expmap("--help")
    assert "..." not in out.partition("Commands:")[2], "a description was cut"


def test_lists_of_commands_say_what_each_says_of_itself():
    root = program.root
    found = [root.get_command(click.Context(root), name) for name in root.list_commands(click.Context(root))]
    for group in [root, *(command for command in found if isinstance(command, click.Group))]:
        context = click.Context(group)
        formatter = click.HelpFormatter(width=1000)
        group.format_commands(context, formatter)
        assert [line.split(maxsplit=1) for line in formatter.getvalue().splitlines()[1:]] == [
            [name, group.get_command(context, name).get_short_help_str(limit=1000)]
            for name in group.list_commands(context)
        ]


@pytest.mark.parametrize("words", [["--version"], ["--help"], ["map", "--help"]])
def test_help_does_not_load_what_computes(words):
    """Heavy libraries are loaded only for a command that needs them."""
    code = f"import sys; from webapp.app.main import main; main({words})"
    done = run("-X", "importtime", "-c", code)
    assert "expmap" in done.stdout
    loaded = {line.rpartition("|")[2].strip() for line in done.stderr.splitlines()}
    assert loaded.isdisjoint({"cv2", "numpy", "faiss", "PIL", "rasterio", "sqlalchemy"})


@pytest.mark.parametrize("module", ["webapp", "webapp.app.main"])
def test_it_runs_as_a_module(module, tmp_path):
    root = Path(program.__file__).parents[2]
    environment = {**os.environ, "PYTHONPATH": str(root)}
    done = run("-m", module, "localize", "--quux", cwd=tmp_path, env=environment)
    assert (done.returncode, done.stdout) == (2, "")
    assert done.stderr == "expmap: No such option '--quux' (see expmap localize --help)\n"


def test_a_shell_completes_options_also_after_a_mistyped_command():
    complete = ShellComplete(program.root, {}, "expmap", "_EXPMAP_COMPLETE").get_completions
    for command, option in (("localise", "--help"), ("localize", "--top")):
        assert option in [item.value for item in complete([command], "--")]


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (["bogus"], "No such command 'bogus' (see expmap --help)"),
        (["map", "bogus"], "No such command 'bogus' (see expmap map --help)"),
        (["localise"], "No such command 'localise'; did you mean 'localize'? (see expmap --help)"),
        (["--quux"], "No such option '--quux' (see expmap --help)"),
        (["build"], "Missing argument 'MAP.cfg' (see expmap build --help)"),
        (["localize", "map.cfg", "a.jpg", "--top", "0"], "Invalid value for '--top': 0 is not in the range"),
        (
            ["localize", "map.cfg", "a.jpg", "--top", "x"],
            "Invalid value for '--top': 'x' is not a whole number (",
        ),
        (
            ["localize", "map.cfg", "a.jpg", "--budget", "x"],
            "Invalid value for '--budget': 'x' is not a number (",
        ),
        (["localize", "map.cfg", "a.jpg", "--method", "best"], "Invalid value for '--method'"),
        (["localize", "map.cfg", "a.jpg", "--features", "brief"], "--features: unknown features 'brief'"),
        (["localize", "map.cfg", "a.jpg", "--picture", "none/a.png"], "--picture: folder none not found"),
        (
            ["localize", "map.cfg", "a.jpg", "--matches", "a.doc"],
            "--matches: cannot write a picture to a.doc",
        ),
        (["evaluate", "map.cfg"], "evaluate: give either QUERIES.csv or --self"),
        (["evaluate", "map.cfg", "none.csv"], "Invalid value for '[QUERIES.csv]'"),
        (
            ["map", "from-photos", ".", "-o", "map.cfg"],
            "--satellite: give either --satellite IMAGE or --blank",
        ),
    ],
)
def test_wrong_usage_is_one_line_and_exit_code_2(expmap, monkeypatch, tmp_path, arguments, says):
    monkeypatch.chdir(tmp_path)
    code, out, err = expmap(*arguments)
    assert (code, out) == (2, "")
    assert err.startswith(f"expmap: {says}")
    assert err.count("\n") == 1 and err.endswith("\n")
    assert list(tmp_path.iterdir()) == []


def test_no_command_shows_the_help(expmap):
    code, out, err = expmap()
    assert code == 2
    assert "Usage: expmap" in out + err


@pytest.mark.parametrize("command", [["build"], ["map", "check"], ["evaluate", "--self"]])
def test_a_missing_map_is_a_bad_map(expmap, tmp_path, command):
    code, out, err = expmap(*command, tmp_path / "none.cfg")
    assert (code, out) == (3, "")
    assert err == f"expmap: {tmp_path / 'none.cfg'}: map file not found (check the path)\n"


def raising(error):
    """A command that ends with an error."""

    def end():
        raise error

    return click.Command("fail", callback=end)


@pytest.mark.parametrize(
    ("error", "code", "says"),
    [
        (errors.UsageError("no", where="--x", hint="take --y"), 2, "expmap: --x: no (take --y)"),
        (errors.MapError("not a map", where="a.cfg"), 3, "expmap: a.cfg: not a map"),
        (errors.CfgError("no id", line=2, column=1, where="a.cfg"), 3, "expmap: a.cfg:2:1: no id"),
        (errors.MapJsonError("no format"), 3, "expmap: no format"),
        (errors.PhotoError("damaged", where="a.jpg"), 1, "expmap: a.jpg: damaged"),
        (errors.GeoreferenceError("on a line"), 1, "expmap: on a line"),
        (errors.TableError("no header"), 1, "expmap: no header"),
        (errors.StorageError("disk full"), 1, "expmap: disk full"),
        (errors.IndexDamaged("cut off"), 1, "expmap: cut off"),
        (errors.ProcessLost("killed", hint="again"), 1, "expmap: killed (again)"),
        (errors.MissingPart("no faiss", hint="install it"), 4, "expmap: no faiss (install it)"),
        (errors.Cancelled("stopped"), 130, "expmap: stopped"),
        (KeyboardInterrupt(), 130, "interrupted"),
        (click.Abort(), 130, "interrupted"),
    ],
)  # fmt: skip
def test_every_error_ends_in_one_line_with_its_code(expmap, monkeypatch, error, code, says):
    monkeypatch.setattr(program, "root", raising(error))
    ended, out, err = expmap()
    assert (ended, out, err.strip()) == (code, "", says)
    assert err.strip().count("\n") == 0


def test_every_kind_of_error_has_an_exit_code_of_its_documentation():
    kinds = [k for k in vars(errors).values() if isinstance(k, type) and issubclass(k, errors.ExpMapError)]
    assert {exit_code(kind.__new__(kind)) for kind in kinds} == {1, 2, 3, 4, 130}


def test_a_reader_that_went_away_is_no_error_message(sample_folder, tmp_path):
    root = Path(program.__file__).parents[2]
    command = f'"{sys.executable}" -m webapp map check "{sample_folder / "map.cfg"}" --json | head -c 1'
    done = subprocess.run(command, shell=True, cwd=root, capture_output=True, text=True, timeout=300)
    assert "Traceback" not in done.stderr


def test_commands_leave_the_work_to_the_tasks():
    folder = Path(program.__file__).parent
    for path in folder.glob("*.py"):
        tree = ast.parse(path.read_text("utf-8"))
        imported = {n.module for n in ast.walk(tree) if isinstance(n, ast.ImportFrom)}
        assert not any(name and name.startswith("webapp.core.localize") for name in imported), path
