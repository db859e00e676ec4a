// Starts the language server of retalis for the files of programs.
"use strict";

const vscode = require("vscode");
const { LanguageClient } = require("vscode-languageclient/node");

let client;

async function activate(context) {
  const [command, ...words] = vscode.workspace.getConfiguration("retalis").get("command");
  const server = { command, args: [...words, "lsp"] };
  const options = {
    documentSelector: [{ scheme: "file", language: "retalis" }, { scheme: "file", pattern: "**/pub_sub.xml" }],
  };
  client = new LanguageClient("retalis", "retalis", server, options);
  context.subscriptions.push(
    vscode.workspace.onDidChangeConfiguration((change) => {
      if (change.affectsConfiguration("retalis.command")) {
        vscode.window.showInformationMessage("retalis: reload the window to start the other command.");
      }
    })
  );
  try {
    await client.start();
  } catch (error) {
    vscode.window.showErrorMessage(
      `retalis: '${[command, ...words, "lsp"].join(" ")}' does not start: ${error.message}. ` +
        "Install it by pip install 'retalis[lsp]', or set retalis.command."
    );
  }
}

async function deactivate() {
  if (client !== undefined && client.isRunning()) {
    await client.stop();
  }
}

module.exports = { activate, deactivate };
