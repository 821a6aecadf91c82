"""Prints the name of each failed test at once; pytest does so only at the end, which can take minutes."""

import pytest


class NamesFailures:
    """A pytest plugin of the process that prints the results."""

    def __init__(self, config: pytest.Config) -> None:
        self._config = config

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        """Print a line for a failed test or fixture."""
        terminal = self._config.pluginmanager.get_plugin("terminalreporter")
        if report.failed and terminal is not None:
            terminal.write(f"\nFAILED {report.nodeid} ({report.when})\n", red=True)
