"""The command `expmap`: every subcommand, and what its errors look like."""

from __future__ import annotations

import difflib
import os
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, cast

import click

from webapp import __version__
from webapp.cli.composition import Composition
from webapp.cli.exitcodes import INTERRUPTED, exit_code
from webapp.configuration import use_config
from webapp.errors import ExpMapError
from webapp.importing import import_name
from webapp.settings import let_threads_sleep

if TYPE_CHECKING:
    from webapp.jobs.kinds import Duties
    from webapp.tasks.operate.backup import LibraryPart


def _duties() -> Duties:
    return cast("Duties", import_name("webapp.app.wings:DUTIES"))


def _library_parts() -> Sequence[LibraryPart]:
    return cast("Sequence[LibraryPart]", import_name("webapp.app.wings:PARTS"))


COMPOSITION = Composition(web_app="webapp.app.web:create_app", duties=_duties, library_parts=_library_parts)


class LazyGroup(click.Group):
    """A group whose commands are imported when they are asked for, so that help and errors come at once.

    Parameters
    ----------
    where : dict of str to str
        Command name to "module:object".
    """

    def __init__(self, *, where: dict[str, str], **options: object) -> None:
        super().__init__(**options)  # type: ignore[arg-type]
        self._where = where

    def list_commands(self, ctx: click.Context) -> list[str]:
        """Name the commands, in the order of the work."""
        return list(self._where)

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        """Import a command; None when there is none of that name."""
        if cmd_name not in self._where:
            return None
        command: click.Command = import_name(self._where[cmd_name])
        return command

    def resolve_command(
        self, ctx: click.Context, args: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        """Find the command that is meant; for a name that is nearly one of them that is suggested."""
        near = difflib.get_close_matches(args[0], self._where, n=1)
        if near and args[0] not in self._where and not ctx.resilient_parsing:
            ctx.fail(f"there is no command {args[0]!r}; did you mean {near[0]!r}?")
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
    where={
        "check": "webapp.cli.map:check",
        "from-photos": "webapp.cli.map:from_photos",
        "write-exif": "webapp.cli.map:write_exif",
        "print": "webapp.cli.print:print_command",
        "floors": "webapp.cli.floors:floors",
        "plan": "webapp.cli.plan:plan",
        "place-rest": "webapp.cli.place_rest:place_rest",
        "blur": "webapp.cli.blur:blur",
        "street-photos": "webapp.cli.street:street_photos",
        "cut-panoramas": "webapp.cli.panoramas:cut_panoramas",
        "join-panoramas": "webapp.cli.panoramas:join_panoramas",
    },
)

landmarks_group = LazyGroup(
    name="landmarks",
    help="Join the photos of a map, for other programs.",
    where={"build": "webapp.cli.landmarks:build", "points": "webapp.cli.landmark_points:points"},
)

mission_group = LazyGroup(
    name="mission",
    help="What robots and people did: tracks, and objects that they saw.",
    where={
        "list": "webapp.missions.cli.mission:list_missions",
        "new": "webapp.missions.cli.mission:new",
        "inspect": "webapp.missions.cli.inspect:inspect",
        "import": "webapp.missions.cli.mission:import_files",
        "export": "webapp.missions.cli.mission:export",
        "thin": "webapp.missions.cli.thinning:thin",
        "prune": "webapp.missions.cli.thinning:prune",
        "keep": "webapp.missions.cli.thinning:keep",
    },
)

foxglove_group = LazyGroup(
    name="foxglove",
    help="Show answers and missions in Foxglove, live or as MCAP files.",
    where={
        "localize": "webapp.cli.foxglove:localize",
        "mission": "webapp.missions.cli.foxglove:mission",
    },
)

account_group = LazyGroup(
    name="account",
    help="Who may sign in, and with what.",
    where={
        "link": "webapp.cli.account:link",
        "token": "webapp.cli.account:token",
        "add": "webapp.cli.account:add",
        "list": "webapp.cli.account:list_accounts",
    },
)

robot_group = LazyGroup(
    name="robot",
    help="Send poses and objects from a robot, through outages.",
    where={
        "send": "webapp.missions.cli.robot:send",
        "replay": "webapp.missions.cli.robot_replay:replay",
        "recover": "webapp.missions.cli.robot:recover",
        "status": "webapp.missions.cli.robot:status",
    },
)

models_group = LazyGroup(
    name="models",
    help="The weights that learned features need.",
    where={"list": "webapp.cli.models:list_models", "fetch": "webapp.cli.models:fetch"},
)

library_group = LazyGroup(
    name="library",
    help="Where the records of a library are.",
    where={"move": "webapp.cli.operate.move:move"},
)

root = LazyGroup(
    name="expmap",
    help="Where was this photo taken? Answers on a map that people make themselves.",
    where={
        "sample": "webapp.sample.cli:sample",
        "map": "webapp.app.main:map_group",
        "build": "webapp.cli.build:build",
        "localize": "webapp.cli.localize:localize",
        "find": "webapp.cli.find:find",
        "evaluate": "webapp.cli.evaluate:evaluate",
        "landmarks": "webapp.app.main:landmarks_group",
        "models": "webapp.app.main:models_group",
        "serve": "webapp.cli.serve:serve",
        "worker": "webapp.cli.serve:worker",
        "mission": "webapp.app.main:mission_group",
        "robot": "webapp.app.main:robot_group",
        "foxglove": "webapp.app.main:foxglove_group",
        "account": "webapp.app.main:account_group",
        "settings": "webapp.cli.settings:settings",
        "backup": "webapp.cli.operate.backup:backup",
        "restore": "webapp.cli.operate.backup:restore",
        "library": "webapp.app.main:library_group",
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
    let_threads_sleep()
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
        # The reader of the output has gone; writing on, even at exit, would only repeat the error.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        code = 1
    sys.exit(code if isinstance(code, int) else 0)


_PLAIN_WORDS = {
    "is not a valid float range": "is not a number",
    "is not a valid float": "is not a number",
    "is not a valid integer range": "is not a whole number",
    "is not a valid integer": "is not a whole number",
}
"""For what click says of a value of the wrong type."""


def _in_one_line(error: click.ClickException) -> str:
    message = " ".join(error.format_message().split()).rstrip(".")
    for jargon, words in _PLAIN_WORDS.items():
        message = message.replace(jargon, words)
    context = error.ctx if isinstance(error, click.UsageError) else None
    return message if context is None else f"{message} (see {context.command_path} --help)"


if __name__ == "__main__":
    main()
