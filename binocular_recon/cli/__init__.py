# SPDX-License-Identifier: Apache-2.0
"""The command line: one module per command, in rooms by what a command is about.

`main` runs the command and turns errors into exit statuses; its `COMMANDS` lists the commands
with their rooms: `clouds` (from images to clouds), `survey` (sizes, and the frame of a site),
`rigs` (calibrations) and `quality` (how good and how fast it is). `options` holds the arguments
that several commands share. A command parses its arguments and calls `apps` or the library; only
commands print. Nothing is exported.
"""
