# SPDX-License-Identifier: Apache-2.0
"""The command line: help, options made from the configuration, exit statuses."""

from __future__ import annotations

import argparse
import dataclasses
import os
import re
import subprocess
import sys
import types
from pathlib import Path

import pytest

from binocular_recon import __version__
from binocular_recon.cli import main as cli
from binocular_recon.cli.main import main
from binocular_recon.cli.options import add_chain_options, chain_config
from binocular_recon.config import PRESETS, ChainConfig, FilterConfig
from binocular_recon.errors import ConfigError


def parse(*words: str, exclude: tuple[str, ...] = ()) -> argparse.Namespace:
    parser = argparse.ArgumentParser()
    add_chain_options(parser, exclude)
    return parser.parse_args(words)


def test_every_command_has_a_module_with_both_functions() -> None:
    for name in cli.COMMANDS:
        module = cli.command_module(name)
        module.add_arguments(argparse.ArgumentParser())
        assert callable(module.run)


def test_a_command_is_one_entry_and_one_module(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    module = types.ModuleType('binocular_recon.cli.clouds.say_twice')
    vars(module).update(
        add_arguments=lambda parser: parser.add_argument('word', help='word to print'),
        run=lambda args: sys.stdout.write(f'{args.word} {args.word}\n'),
    )
    monkeypatch.setitem(sys.modules, module.__name__, module)
    monkeypatch.setitem(cli.COMMANDS, 'say-twice', ('clouds', 'print a word twice'))
    assert main(['say-twice', 'rod']) == 0
    assert capsys.readouterr().out == 'rod rod\n'
    with pytest.raises(SystemExit, match='0'):
        main(['--help'])
    assert re.search(r'^    say-twice +print a word twice$', capsys.readouterr().out, re.MULTILINE)
    with pytest.raises(SystemExit, match='0'):
        main(['say-twice', '--help'])
    text = capsys.readouterr().out
    assert text.startswith('usage: binocular-recon say-twice [-h] word\n\nPrint a word twice.\n')


@pytest.mark.parametrize(
    'program',
    [
        [sys.executable, '-m', 'binocular_recon'],
        [str(Path(sys.executable).with_name('binocular-recon'))],
    ],
    ids=['module', 'console command'],
)
def test_messages_name_the_console_command_however_it_was_started(
    program: list[str], tmp_path: Path
) -> None:
    def run(*words: str) -> tuple[int, str, str]:
        done = subprocess.run([*program, *words], capture_output=True, text=True, check=False)
        return done.returncode, done.stdout, done.stderr

    assert run('--version') == (0, f'binocular-recon {__version__}\n', '')
    status, text, _ = run('play', '--help')
    assert status == 0
    assert text.startswith('usage: binocular-recon play [-h] ')
    status, _, error = run('play')
    assert status == 2
    assert error.startswith('usage: binocular-recon play [-h] ')
    assert error.endswith(
        'binocular-recon play: error: the following arguments are required: BAG\n'
    )
    bag, output = str(tmp_path / 'gone'), str(tmp_path / 'out')
    assert run('reconstruct', bag, '--output', output) == (
        1,
        '',
        f'binocular-recon reconstruct: {bag} does not exist; check the path of the bag\n',
    )


def test_help_names_the_commands_and_imports_nothing_slow() -> None:
    script = (
        'import sys\n'
        'from binocular_recon.cli.main import main\n'
        'try:\n    main(sys.argv[1:])\n'
        'except SystemExit as end:\n    assert end.code == 0\n'
        "slow = {'numpy', 'cv2', 'numba', 'scipy', 'rosbags', 'rclpy', 'yaml'}\n"
        'slow &= set(sys.modules)\n'
        'assert not slow, slow\n'
    )
    for words in (['--help'], ['reconstruct', '--help'], ['match', '--help'], ['--version']):
        command = [sys.executable, '-c', script, *words]
        done = subprocess.run(command, capture_output=True, text=True, check=True)
        if words == ['--help']:
            assert all(f'\n    {name}' in done.stdout for name in cli.COMMANDS)
        if words == ['--version']:
            assert done.stdout == f'binocular-recon {__version__}\n'


@pytest.mark.parametrize(
    'words',
    [
        [],
        ['nonsense'],
        ['match', 'l.png'],
        *(['play', 'b', '--rate', rate] for rate in ('0', 'inf', 'nan')),
        ['reconstruct', 'b', '--output', 'o', '--approximate-sync-tolerance-seconds', 'inf'],
    ],
)
def test_wrong_usage_exits_2(words: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as end:
        main(words)
    assert end.value.code == 2
    assert 'usage: binocular-recon' in capsys.readouterr().err


def test_every_option_of_the_chain_is_a_flag_and_none_restates_its_default() -> None:
    groups = [getattr(ChainConfig(), group.name) for group in dataclasses.fields(ChainConfig)]
    specs = {spec.name: spec for group in groups for spec in dataclasses.fields(group)}
    assert vars(parse()) == {'preset': 'default'}
    assert chain_config(parse()) == ChainConfig()
    parser = argparse.ArgumentParser()
    add_chain_options(parser)
    actions = {action.dest: action for action in parser._actions}
    for name, spec in specs.items():
        assert f'--{name.replace("_", "-")}' in actions[name].option_strings
        text = str(actions[name].help).replace('%%', '%')
        assert text.startswith(spec.metadata['description'])
        assert spec.metadata['unit'] in text
    parser.format_help()


@pytest.mark.parametrize('preset', PRESETS)
def test_an_explicit_option_wins_over_the_preset(preset: str) -> None:
    args = parse('--preset', preset, '--wls-lambda', '0.5', '--wls-guide', 'disparity')
    config = chain_config(args, disparity_range=64)
    assert config == ChainConfig.preset(
        preset, wls_lambda=0.5, wls_guide='disparity', disparity_range=64
    )
    assert chain_config(parse('--preset', preset)) == ChainConfig.preset(preset)


def test_switches_are_read() -> None:
    (name,) = [
        spec.name for spec in dataclasses.fields(FilterConfig) if isinstance(spec.default, bool)
    ][:1]
    flag = name.replace('_', '-')
    for words, value in (([f'--{flag}'], True), ([f'--no-{flag}'], False)):
        assert getattr(chain_config(parse(*words)).filter, name) is value


@pytest.mark.parametrize(
    ('words', 'message'),
    [
        (['--wls-alpha', '9'], r'argument --wls-alpha: wls_alpha must be within 0\.0\.\.4\.0'),
        (['--wls-alpha', 'much'], "'much' is not a valid NUMBER"),
        (['--disparity-range', '1.5'], "'1.5' is not a valid INTEGER"),
        (['--correlation-window-size', '8'], 'must be 3 plus a multiple of 2'),
        (['--wls-guide', 'right'], 'wls_guide must be one of left, disparity'),
        (['--preset', 'best'], "invalid choice: 'best'"),
    ],
)
def test_options_out_of_range_are_refused_with_the_range(
    words: list[str], message: str, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit, match='2'):
        parse(*words)
    assert re.search(message, capsys.readouterr().err)


def test_excluded_options_are_not_flags() -> None:
    with pytest.raises(SystemExit, match='2'):
        parse('--min-depth', '1', exclude=('min_depth',))


def test_errors_become_one_line_and_a_status(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    from binocular_recon.cli.clouds import play
    from binocular_recon.errors import BagError

    for error, status, line in (
        (BagError('a\n  b'), 1, 'binocular-recon play: a b\n'),
        (ConfigError('x must be 1'), 2, 'binocular-recon play: x must be 1\n'),
        (OSError(28, 'No space left on device', 'f'), 1, None),
        (
            MemoryError('9 GiB'),
            1,
            'binocular-recon play: 9 GiB; choose a smaller disparity_range or smaller images\n',
        ),
        (
            KeyboardInterrupt('3 frames kept'),
            130,
            'binocular-recon play: interrupted; 3 frames kept\n',
        ),
        (KeyboardInterrupt(), 130, 'binocular-recon play: interrupted\n'),
    ):

        def fail(_args: argparse.Namespace, error: BaseException = error) -> None:
            raise error

        monkeypatch.setattr(play, 'run', fail)
        assert main(['play', 'bag']) == status
        text = capsys.readouterr().err
        assert text.count('\n') == 1
        assert line is None or text == line


def test_a_closed_pipe_ends_the_command_without_a_message() -> None:
    script = (
        'import sys\n'
        'from binocular_recon.cli import main\nfrom binocular_recon.cli.clouds import play\n'
        'play.run = lambda args: print("x" * 1_000_000)\n'
        'sys.exit(main.main(["play", "bag"]))\n'
    )
    command = [sys.executable, '-c', script]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE) as process:
        assert process.stdout is not None
        assert process.stderr is not None
        process.stdout.read(10)
        process.stdout.close()
        assert process.stderr.read() == b''
        assert process.wait(20) == 1


@pytest.mark.parametrize('error', ['RuntimeError', 'OSError', 'SystemError'])
@pytest.mark.parametrize(('number', 'status'), [('SIGINT', 130), ('SIGTERM', 143)])
def test_interrupt_that_an_extension_turns_into_another_error(
    error: str, number: str, status: int
) -> None:
    script = (
        'import os, signal\n'
        'from binocular_recon.cli import main\nfrom binocular_recon.cli.clouds import play\n'
        'def run(args):\n'
        '    try:\n'
        f'        os.kill(os.getpid(), signal.{number})\n'
        '    except KeyboardInterrupt:\n'
        '        pass\n'
        f'    raise {error}("unable to convert")\n'
        'play.run = run\n'
        'main.main()\n'
    )
    command = [sys.executable, '-c', script, 'play', 'bag']
    run = subprocess.run(command, capture_output=True, text=True, check=False)
    assert run.returncode == status, run.stderr
    assert run.stderr.count('\n') == 1, run.stderr


def test_play_without_ros_says_what_to_do(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    monkeypatch.setitem(sys.modules, 'rclpy', None)
    assert main(['play', str(tmp_path)]) == 1
    assert 'ROS 2 is not installed' in capsys.readouterr().err


def test_names_that_no_terminal_can_print() -> None:
    """Neither a character that its encoding lacks nor an escape sequence is written to it."""
    script = (
        'from binocular_recon.cli import main, options\n'
        'from binocular_recon.cli.clouds import play\n'
        'play.run = lambda args: options.say(args.bag)\n'
        'main.main()\n'
    )
    for name, encoding, printed in (
        ('b\xe4g', 'ascii', 'b\\xe4g'),
        ('b\xe4g', 'utf-8', 'b\xe4g'),
        (os.fsdecode(b'b\xffg'), 'utf-8', 'b\\udcffg'),
        ('b\x1b[2Jg', 'utf-8', 'b\\x1b[2Jg'),
    ):
        done = subprocess.run(
            [sys.executable, '-c', script, 'play', name],
            capture_output=True,
            check=False,
            env={**os.environ, 'PYTHONIOENCODING': encoding},
        )
        assert (done.returncode, done.stdout.decode()) == (0, f'{printed}\n'), done.stderr
    command = [sys.executable, '-m', 'binocular_recon', 'play', 'bag', '--\x1b[2J']
    done = subprocess.run(command, capture_output=True, check=False)
    assert done.returncode == 2
    assert b'unrecognized arguments: --\\x1b[2J' in done.stderr and b'\x1b' not in done.stderr


def test_commands_print_by_say_and_note_only() -> None:
    for path in Path(cli.__file__).parent.glob('*/*.py'):
        assert not re.search(r'(?<!\w)print\(', path.read_text()), path


def test_a_current_folder_that_was_removed(tmp_path: Path) -> None:
    script = 'import os, sys; os.rmdir(os.getcwd()); os.execv(sys.executable, sys.argv[1:])'
    run = [sys.executable, '-m', 'binocular_recon', 'reconstruct', 'bag', '--output', 'out']
    command = [sys.executable, '-c', script, *run]
    folder = tmp_path / 'gone'
    folder.mkdir()
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)
    assert done.returncode == 1
    assert done.stderr == (
        'binocular-recon reconstruct: bag does not exist; check the path of the bag\n'
    )
