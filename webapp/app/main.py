"""The command `expmap`: its subcommands, and the form of its error messages."""

from __future__ import annotations

import difflib
import os
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple, cast

import click

from webapp import __version__
from webapp.cli.composition import Composition
from webapp.cli.exitcodes import INTERRUPTED, exit_code
from webapp.configuration import rename_old_variables, use_config
from webapp.errors import ExpMapError
from webapp.importing import import_name
from webapp.settings import restrain_threads

if TYPE_CHECKING:
    from webapp.jobs.kinds import JobRegistry
    from webapp.tasks.operate.backup import LibraryPart


def _registry() -> JobRegistry:
    return cast("JobRegistry", import_name("webapp.app.registry:REGISTRY"))


def _library_parts() -> Sequence[LibraryPart]:
    return cast("Sequence[LibraryPart]", import_name("webapp.app.registry:LIBRARY_PARTS"))


COMPOSITION = Composition(
    web_app="webapp.app.web:create_app", registry=_registry, library_parts=_library_parts
)


class LazyCommand(NamedTuple):
    """A command that is imported on demand."""

    where: str  # "module:object"
    summary: str  # First sentence of its help


class LazyGroup(click.Group):
    """A group whose commands are imported on demand, so that help and errors appear quickly."""

    def __init__(self, *, commands: dict[str, LazyCommand], **options: object) -> None:
        super().__init__(**options)  # type: ignore[arg-type]
        self._lazy = commands

    def list_commands(self, ctx: click.Context) -> list[str]:
        """Return the names of the commands, in the order of a typical workflow."""
        return list(self._lazy)

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        """Import a command; returns None if there is none of that name."""
        if cmd_name not in self._lazy:
            return None
        command: click.Command = import_name(self._lazy[cmd_name].where)
        return command

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """List the commands with their summaries, without importing them."""
        if not self._lazy:
            return
        with formatter.section("Commands"):
            formatter.write_dl([(name, command.summary) for name, command in self._lazy.items()])

    def resolve_command(
        self, ctx: click.Context, args: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        """Find a command; if the name is misspelled, the error suggests the closest one."""
        near = difflib.get_close_matches(args[0], self._lazy, n=1)
        if near and args[0] not in self._lazy and not ctx.resilient_parsing:
            ctx.fail(f"No such command {args[0]!r}; did you mean {near[0]!r}?")
        return super().resolve_command(ctx, args)


def _show_version(ctx: click.Context, _option: click.Parameter, wanted: bool) -> None:
    if wanted:
        click.echo(f"expmap {__version__}")
        ctx.exit()


def _use_config(_ctx: click.Context, _option: click.Parameter, path: Path | None) -> None:
    if path is not None:
        use_config(path)


map_group = LazyGroup(
    name="map",
    help="Make and check map files.",
    commands={
        "check": LazyCommand("webapp.cli.map:check", "Check a map file and say how to fix what is wrong."),
        "calibrate": LazyCommand(
            "webapp.cli.map:calibrate_command", "Calibrate a map's probabilities, also on real queries."
        ),
        "from-photos": LazyCommand("webapp.cli.map:from_photos", "Make a map from the photos in a folder."),
        "inspect": LazyCommand("webapp.cli.map:inspect", "Show how photos and plans are understood."),
        "write-exif": LazyCommand(
            "webapp.cli.map:write_exif", "Write positions into the EXIF of photos, or of copies."
        ),
        "print": LazyCommand("webapp.cli.print:print_command", "Print a map as PDF or PNG."),
        "floors": LazyCommand("webapp.cli.floors:floors", "List, add or remove the floors of a map."),
        "plan": LazyCommand("webapp.cli.plan:plan", "Plan where to take the next photos."),
        "place-rest": LazyCommand(
            "webapp.cli.place_rest:place_rest", "Place the photos in the tray using those already placed."
        ),
        "blur": LazyCommand(
            "webapp.cli.blur:blur", "Find faces and number plates in the photos, and blur them."
        ),
        "street-photos": LazyCommand(
            "webapp.cli.street:street_photos", "Add street-level photos from Panoramax or Mapillary."
        ),
        "cut-panoramas": LazyCommand(
            "webapp.cli.cut:cut_panoramas", "Cut panoramas into level perspective views."
        ),
        "cut-video": LazyCommand(
            "webapp.cli.cut:cut_video", "Make photos of the sharp, spread frames of a video."
        ),
        "join-panoramas": LazyCommand(
            "webapp.cli.cut:join_panoramas", "Join photos from several cameras into panoramas."
        ),
    },
)

landmarks_group = LazyGroup(
    name="landmarks",
    help="Build the landmarks of a map, and manage its control points.",
    commands={
        "build": LazyCommand(
            "webapp.cli.landmarks:build", "Build the landmarks of a map by structure from motion."
        ),
        "points": LazyCommand(
            "webapp.cli.landmark_points:points", "List, read or write the control points of a map."
        ),
        "tags": LazyCommand("webapp.cli.landmarks:tags", "Print tags that are recognised in photos, as PDF."),
    },
)

mission_group = LazyGroup(
    name="mission",
    help="Manage missions: tracks of robots and people, and the objects they saw.",
    commands={
        "list": LazyCommand(
            "webapp.missions.cli.mission:list_missions",
            "List all missions: number, name, poses, objects, and time of the last change.",
        ),
        "new": LazyCommand("webapp.missions.cli.mission:new", "Make a mission and print its number."),
        "inspect": LazyCommand(
            "webapp.missions.cli.inspect:inspect",
            "Show what FILES contain: each source with its poses, times and extent, and anything odd.",
        ),
        "import": LazyCommand(
            "webapp.missions.cli.mission:import_files",
            "Import tracks and objects from FILES into the mission with the number MISSION.",
        ),
        "export": LazyCommand(
            "webapp.missions.cli.mission:export",
            "Export the mission with the number MISSION to FILE; `-` is standard output.",
        ),
        "fuse": LazyCommand(
            "webapp.missions.cli.mission:fuse",
            "Fuse the tracks of the mission with the number MISSION into a corrected one.",
        ),
        "thin": LazyCommand(
            "webapp.missions.cli.mission:thin",
            "Remove poses from the tracks of missions, keeping the error below a limit at all times.",
        ),
        "prune": LazyCommand(
            "webapp.missions.cli.mission:prune",
            "Remove all poses from the tracks of missions except the first and the last.",
        ),
        "keep": LazyCommand(
            "webapp.missions.cli.mission:keep",
            "Mark missions to be kept as they are, whatever the settings say about old missions.",
        ),
    },
)

foxglove_group = LazyGroup(
    name="foxglove",
    help="Show answers and missions in Foxglove, live or as MCAP files.",
    commands={
        "localize": LazyCommand("webapp.cli.foxglove:localize", "Show answers with their pictures."),
        "mission": LazyCommand("webapp.missions.cli.foxglove:mission", "Show a mission."),
    },
)

account_group = LazyGroup(
    name="account",
    help="Manage accounts, sign-in links and tokens.",
    commands={
        "link": LazyCommand("webapp.cli.library:link", "Print a one-time sign-in link."),
        "token": LazyCommand(
            "webapp.cli.library:token", "Print a token for a program: `Authorization: Bearer TOKEN`."
        ),
        "add": LazyCommand(
            "webapp.cli.library:add", "Create an account, and print a one-time sign-in link for it."
        ),
        "list": LazyCommand(
            "webapp.cli.library:list_accounts",
            "List all accounts: name, whether it owns the library, and date of creation.",
        ),
    },
)

robot_group = LazyGroup(
    name="robot",
    help="Send poses and objects from a robot, even over an unreliable network.",
    commands={
        "send": LazyCommand(
            "webapp.missions.cli.robot:send",
            "Send records that another program prints: one JSON object per line, as in batches.",
        ),
        "replay": LazyCommand(
            "webapp.missions.cli.robot_replay:replay",
            "Send a recorded mission, BAG, to a server as if it were happening.",
        ),
        "recover": LazyCommand(
            "webapp.missions.cli.robot:recover", "Upload what a robot has left in the folder SPOOL."
        ),
        "status": LazyCommand(
            "webapp.missions.cli.robot:status",
            "Show what is in the folder SPOOL, even while the robot is writing to it.",
        ),
    },
)

models_group = LazyGroup(
    name="models",
    help="List and fetch the models that learned features need.",
    commands={
        "list": LazyCommand(
            "webapp.cli.models:list_models", "List the models and whether they are installed."
        ),
        "fetch": LazyCommand(
            "webapp.cli.models:fetch",
            "Fetch all models, or those named, into EXPMAP_MODELS or the user's cache.",
        ),
        "check": LazyCommand(
            "webapp.cli.models:check",
            "Try each installed model on a pair of pictures, which the program draws.",
        ),
    },
)

library_group = LazyGroup(
    name="library",
    help="Move a library to another database or storage.",
    commands={
        "move": LazyCommand(
            "webapp.cli.operate:move",
            "Move the records of a library from SQLite to PostgreSQL, or its photos into S3, or back.",
        )
    },
)

cluster_group = LazyGroup(
    name="cluster",
    help="Try out a setup of several machines.",
    commands={
        "demo": LazyCommand(
            "webapp.cli.demo.cluster:demo",
            "Run all parts of a setup of several machines on this one until Ctrl-C.",
        )
    },
)

root = LazyGroup(
    name="expmap",
    help="Where was this photo taken? Answers on a map that people make themselves.",
    commands={
        "sample": LazyCommand(
            "webapp.sample.cli:sample", "Make a small map of a synthetic park, with photos to localize."
        ),
        "map": LazyCommand("webapp.app.main:map_group", "Make and check map files."),
        "build": LazyCommand("webapp.cli.build:build", "Build the index of a map, or bring it up to date."),
        "localize": LazyCommand("webapp.cli.localize:localize", "Say where photos were taken."),
        "find": LazyCommand("webapp.cli.find:find", "Say which map photos were taken on."),
        "evaluate": LazyCommand(
            "webapp.cli.evaluate:evaluate",
            "Measure the accuracy of the answers on photos whose positions are known.",
        ),
        "landmarks": LazyCommand(
            "webapp.app.main:landmarks_group", "Build the landmarks of a map, and manage its control points."
        ),
        "models": LazyCommand(
            "webapp.app.main:models_group", "List and fetch the models that learned features need."
        ),
        "serve": LazyCommand(
            "webapp.cli.serve:serve", "Serve the maps of a library as web pages until Ctrl-C."
        ),
        "worker": LazyCommand(
            "webapp.cli.serve:worker", "Run the background jobs of a library until Ctrl-C."
        ),
        "mission": LazyCommand(
            "webapp.app.main:mission_group",
            "Manage missions: tracks of robots and people, and the objects they saw.",
        ),
        "robot": LazyCommand(
            "webapp.app.main:robot_group",
            "Send poses and objects from a robot, even over an unreliable network.",
        ),
        "foxglove": LazyCommand(
            "webapp.app.main:foxglove_group", "Show answers and missions in Foxglove, live or as MCAP files."
        ),
        "connect": LazyCommand("webapp.app.connect:connect_group", "Connect with other programs."),
        "account": LazyCommand("webapp.app.main:account_group", "Manage accounts, sign-in links and tokens."),
        "settings": LazyCommand(
            "webapp.cli.settings:settings", "Print the value of each setting and where it comes from."
        ),
        "doctor": LazyCommand(
            "webapp.cli.operate:doctor",
            "Check this installation and a library, and say what to do.",
        ),
        "backup": LazyCommand("webapp.cli.operate:backup", "Back up a whole library to FILE, a zip archive."),
        "restore": LazyCommand("webapp.cli.operate:restore", "Restore a library from the backup FILE."),
        "library": LazyCommand(
            "webapp.app.main:library_group", "Move a library to another database or storage."
        ),
        "cluster": LazyCommand("webapp.app.main:cluster_group", "Try out a setup of several machines."),
    },
    context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 110},
    params=[
        click.Option(
            ["--config"],
            type=click.Path(dir_okay=False, path_type=Path),
            metavar="FILE",
            expose_value=False,
            callback=_use_config,
            help="TOML file with settings.  [default: EXPMAP_CONFIG]",
        ),
        click.Option(
            ["--version"],
            is_flag=True,
            expose_value=False,
            is_eager=True,
            callback=_show_version,
            help="Show the version and exit.",
        ),
    ],
)


def main(arguments: Sequence[str] | None = None) -> None:
    """Run a command and exit with its code; an error is one line on standard error."""
    restrain_threads()
    for message in rename_old_variables():
        click.echo(f"expmap: {message}", err=True)
    try:
        code = root.main(args=arguments, prog_name="expmap", standalone_mode=False, obj=COMPOSITION)
    except click.exceptions.NoArgsIsHelpError as error:
        error.show()
        code = error.exit_code
    except click.ClickException as error:
        click.echo(f"expmap: {_in_one_line(error)}", err=True)
        code = error.exit_code
    except (click.Abort, KeyboardInterrupt):
        click.echo("interrupted", err=True)
        code = INTERRUPTED
    except ExpMapError as error:
        click.echo(f"expmap: {error}", err=True)
        code = exit_code(error)
    except BrokenPipeError:
        # The reader of the output is gone; further writing, even the flush at exit, would fail again.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        code = 1
    sys.exit(code if isinstance(code, int) else 0)


_PLAIN_WORDS = {
    "is not a valid float range": "is not a number",
    "is not a valid float": "is not a number",
    "is not a valid integer range": "is not a whole number",
    "is not a valid integer": "is not a whole number",
}
"""Replacements for click's messages about values of the wrong type."""


def _in_one_line(error: click.ClickException) -> str:
    message = " ".join(error.format_message().split()).rstrip(".")
    for jargon, words in _PLAIN_WORDS.items():
        message = message.replace(jargon, words)
    context = error.ctx if isinstance(error, click.UsageError) else None
    return message if context is None else f"{message} (see {context.command_path} --help)"


if __name__ == "__main__":
    main()
