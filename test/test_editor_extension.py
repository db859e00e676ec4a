"""Extension for VS Code: the packed folder, and the server that it starts."""

import json
import os
import shutil
import subprocess
from pathlib import Path
from typing import Any, List

import pytest
from parsed_sources import ROOT

FOLDER = ROOT / "docs" / "editors" / "vscode"
STARTED_BY_HOOK = """
const Module = require("module");
const started = [];
const stubs = {
  vscode: {
    workspace: {
      getConfiguration: () => ({ get: () => JSON.parse(process.argv[2]) }),
      onDidChangeConfiguration: () => ({ dispose() {} }),
    },
    window: { showErrorMessage: (text) => started.push({ error: text }) },
  },
  "vscode-languageclient/node": {
    LanguageClient: class {
      constructor(id, name, server, options) {
        Object.assign(this, { server, options });
      }
      async start() {
        if (this.server.command === "missing") throw new Error("spawn missing ENOENT");
        started.push({ server: this.server, selector: this.options.documentSelector });
      }
      isRunning() { return true; }
      async stop() { started.push("stopped"); }
    },
  },
};
const load = Module._load;
Module._load = (name, ...rest) => stubs[name] || load(name, ...rest);
const extension = require(process.argv[1]);
extension.activate({ subscriptions: [] }).then(() => extension.deactivate()).then(() => {
  console.log(JSON.stringify(started));
});
"""


def run(program: str, *arguments: str, folder: Path = FOLDER) -> Any:
    """Run a program of Node.js; return what it prints as JSON."""
    path = shutil.which(program)
    if path is None:
        pytest.skip(f"there is no {program}")
    environment = {"PATH": os.environ["PATH"], "HOME": str(folder)}
    output = subprocess.run(
        [path, *arguments], cwd=str(folder), env=environment, check=True, stdout=subprocess.PIPE, timeout=120
    )
    return json.loads(output.stdout)


def activate(command: List[str]) -> Any:
    return run("node", "-e", STARTED_BY_HOOK, str(FOLDER / "extension.js"), json.dumps(command))


def test_extension_starts_and_stops_server() -> None:
    started, stopped = activate(["/opt/venv/bin/retalis"])
    assert started["server"] == {"command": "/opt/venv/bin/retalis", "args": ["lsp"]}
    assert {"scheme": "file", "language": "retalis"} in started["selector"]
    assert stopped == "stopped"


def test_command_may_have_arguments() -> None:
    started = activate(["python3", "-m", "retalis"])[0]
    assert started["server"] == {"command": "python3", "args": ["-m", "retalis", "lsp"]}


def test_server_that_does_not_start_is_reported() -> None:
    error = activate(["missing"])[0]["error"]
    assert error.startswith("retalis: 'missing lsp' does not start: spawn missing ENOENT.")
    assert "pip install 'retalis[lsp]'" in error


@pytest.mark.slow
def test_packed_folder_has_files_of_manifest(tmp_path: Path) -> None:
    shutil.copytree(FOLDER, tmp_path / "vscode")
    (package,) = run("npm", "pack", "--dry-run", "--json", "--offline", folder=tmp_path / "vscode")
    packed = {file["path"] for file in package["files"]}
    manifest = json.loads((FOLDER / "package.json").read_text(encoding="utf-8"))
    (language,) = manifest["contributes"]["languages"]
    (grammar,) = manifest["contributes"]["grammars"]
    named = [manifest["main"], language["configuration"], grammar["path"]]
    assert packed == {"package.json", *(os.path.normpath(path) for path in named)}
