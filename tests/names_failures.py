"""Names each test that fails at once: a part of the suite takes minutes, and pytest names them at its end."""

import pytest


class NamesFailures:
    """A plugin of the process that prints the results."""

    def __init__(self, config: pytest.Config) -> None:
        self._config = config

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        """Write a line for a test that failed, or whose fixtures did."""
        terminal = self._config.pluginmanager.get_plugin("terminalreporter")
        if report.failed and terminal is not None:
            terminal.write(f"\nFAILED {report.nodeid} ({report.when})\n", red=True)
