# SPDX-License-Identifier: Apache-2.0
"""The command line: one module per command.

`main` runs the command and turns errors into exit statuses; its `COMMANDS` is the list of
commands. `options` holds the arguments that several commands share. A command parses its
arguments and calls `apps` or the library; only commands print. Nothing is exported.
"""
