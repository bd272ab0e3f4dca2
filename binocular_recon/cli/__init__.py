# SPDX-License-Identifier: Apache-2.0
"""The command line: one module per command.

`main` finds the command, runs it and turns errors into exit statuses; `options` are those that
several commands share. A command parses arguments and calls `apps` or the library; it is the
only place that prints. Nothing is exported.
"""
