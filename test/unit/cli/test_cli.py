# SPDX-License-Identifier: Apache-2.0
"""The command line: help, options made from the configuration, exit statuses."""

from __future__ import annotations

import argparse
import dataclasses
import importlib
import io
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from binocular_recon import __version__
from binocular_recon.apps.progress import ProgressBar
from binocular_recon.cli import main as cli
from binocular_recon.cli.main import main
from binocular_recon.cli.options import add_chain_options, chain_config
from binocular_recon.config import PRESETS, ChainConfig, FilterConfig
from binocular_recon.errors import ConfigError
from binocular_recon.io.image_files import write_image_file
from binocular_recon.io.pfm import read_pfm
from test.bag_tools import pictures


def parse(*words: str, exclude: tuple[str, ...] = ()) -> argparse.Namespace:
    parser = argparse.ArgumentParser()
    add_chain_options(parser, exclude)
    return parser.parse_args(words)


def test_every_command_has_a_module_with_both_functions() -> None:
    for name in cli.COMMANDS:
        module = importlib.import_module(f'binocular_recon.cli.{name}')
        module.add_arguments(argparse.ArgumentParser())
        assert callable(module.run)


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
            assert done.stdout == f'binocular_recon {__version__}\n'


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
    assert 'usage: binocular_recon' in capsys.readouterr().err


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
        (['--wls-alpha', 'much'], "'much' is no NUMBER"),
        (['--disparity-range', '1.5'], "'1.5' is no INTEGER"),
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


def test_excluded_options_are_no_flags() -> None:
    with pytest.raises(SystemExit, match='2'):
        parse('--min-depth', '1', exclude=('min_depth',))


def test_errors_become_one_line_and_a_status(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    from binocular_recon.cli import play
    from binocular_recon.errors import BagError

    for error, status, line in (
        (BagError('a\n  b'), 1, 'binocular_recon play: a b\n'),
        (ConfigError('x must be 1'), 2, 'binocular_recon play: x must be 1\n'),
        (OSError(28, 'No space left on device', 'f'), 1, None),
        (
            MemoryError('9 GiB'),
            1,
            'binocular_recon play: 9 GiB; choose a smaller disparity_range or smaller pictures\n',
        ),
        (
            KeyboardInterrupt('3 frames kept'),
            130,
            'binocular_recon play: interrupted; 3 frames kept\n',
        ),
        (KeyboardInterrupt(), 130, 'binocular_recon play: interrupted\n'),
    ):

        def fail(_args: argparse.Namespace, error: BaseException = error) -> None:
            raise error

        monkeypatch.setattr(play, 'run', fail)
        assert main(['play', 'bag']) == status
        text = capsys.readouterr().err
        assert text.count('\n') == 1
        assert line is None or text == line


def test_a_reader_that_has_enough_is_no_problem_to_talk_about() -> None:
    script = (
        'import sys\n'
        'from binocular_recon.cli import main, play\n'
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


def test_play_without_ros_says_what_to_do(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    monkeypatch.setitem(sys.modules, 'rclpy', None)
    assert main(['play', str(tmp_path)]) == 1
    assert 'ROS 2 is not installed' in capsys.readouterr().err


class Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


def test_progress_is_drawn_on_a_terminal_only(monkeypatch: pytest.MonkeyPatch) -> None:
    for stream, seen in ((Terminal(), True), (io.StringIO(), False)):
        monkeypatch.setattr(sys, 'stderr', stream)
        with ProgressBar(4, 'frames') as bar:
            bar.show(2)
            assert ('2 of 4 frames' in stream.getvalue()) is seen
            assert ('####' in stream.getvalue()) is seen
            bar.show(3)  # too soon to be drawn
            assert '3 of 4 frames' not in stream.getvalue()
        assert stream.getvalue().endswith('\r\033[K') is seen


def test_match_writes_raw_disparity(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for name, image in zip(('left', 'right'), pictures(3), strict=True):
        write_image_file(tmp_path / f'{name}.png', image)
    files = [str(tmp_path / name) for name in ('left.png', 'right.png', 'new/d.pfm', 'new/d.png')]
    words = [
        'match',
        *files[:2],
        '--max-disparity',
        '15',
        '--output',
        files[2],
        '--heat-map',
        files[3],
    ]
    assert main(words) == 0
    disparity_px = read_pfm(Path(files[2]))
    assert np.isfinite(disparity_px).all()
    # the left picture is 6 px ahead of the right one
    inner = disparity_px[8:-8, 24:-8]
    assert np.median(np.abs(inner - 6)) < 0.05
    assert np.mean(np.abs(inner - 6) < 0.5) > 0.98
    assert Path(files[3]).stat().st_size > 1000
    assert 'density 100.0%' in capsys.readouterr().out


def test_match_complains_about_the_pictures(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    left, right = pictures(0)
    write_image_file(tmp_path / 'left.png', left)
    write_image_file(tmp_path / 'right.png', right[:, :-3])
    (tmp_path / 'file').write_text('')
    common = ['--max-disparity', '15']
    out = ['--output', str(tmp_path / 'd.pfm')]
    pair = [str(tmp_path / 'left.png'), str(tmp_path / 'right.png')]
    for words, status, message in (
        ([pair[0], str(tmp_path / 'gone.png'), *out], 1, 'gone.png cannot be read'),
        ([*pair, *out], 1, '(72, 96) and right (72, 93)'),
        ([pair[0], pair[0], '--output', str(tmp_path / 'file/d.pfm')], 1, 'file'),
        ([*pair, *out, '--min-disparity', '15'], 2, 'above the smallest disparity, 15 px, got 15'),
    ):
        assert main(['match', *words, *common]) == status
        text = capsys.readouterr().err
        assert message in text
        assert text.count('\n') == 1
    assert not (tmp_path / 'd.pfm').exists()
