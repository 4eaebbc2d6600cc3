"""A headless Chromium for tests of pages. pip brings its driver's client, but no browser."""

import os
import shutil
import time

import photograph
import pytest


def opened():
    """A browser without a window, which draws WebGL in software.

    Where CI is set a missing browser is a failure: nothing is skipped there.
    """
    browser, driver = photograph.browser(), shutil.which("chromedriver")
    if browser is None or driver is None:
        missing = "needs Chromium and chromedriver (Debian: apt install chromium chromium-driver)"
        if os.environ.get("CI"):
            pytest.fail(missing)
        pytest.skip(missing)
    from selenium import webdriver
    from selenium.webdriver.chrome.service import Service

    options = webdriver.ChromeOptions()
    options.binary_location = browser
    options.set_capability("goog:loggingPrefs", {"browser": "ALL"})
    for argument in (
        *("--headless=new", "--no-sandbox", "--disable-dev-shm-usage", "--window-size=900,650"),
        *("--use-angle=swiftshader", "--enable-unsafe-swiftshader"),
    ):
        options.add_argument(argument)
    chrome = webdriver.Chrome(options=options, service=Service(driver))
    # A page that software draws on a busy machine takes its time.
    chrome.set_script_timeout(120)
    return chrome


def wait_for(chrome, script, seconds=60.0):
    """Waits until a script gives something true, and returns that."""
    until = time.monotonic() + seconds
    while time.monotonic() < until:
        if value := chrome.execute_script(script):
            return value
        time.sleep(0.1)
    raise AssertionError(f"not within {seconds:g} s: {script}; {chrome.get_log('browser')}")


def complaints(chrome):
    """What the page's scripts reported as wrong."""
    return [entry for entry in chrome.get_log("browser") if entry["level"] == "SEVERE"]
