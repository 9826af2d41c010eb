"""A web page as the place where a person sits."""

from haim_torchrl.human.browser.console import BrowserConsole

__all__ = ["BrowserConsole"]
