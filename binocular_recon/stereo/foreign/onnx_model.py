# SPDX-License-Identifier: Apache-2.0
"""A network of an ONNX file: loaded once, what it takes and what it gives."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from binocular_recon._jit import thread_count
from binocular_recon.errors import BinocularReconError, FileError, shortened
from binocular_recon.images import FloatImage, Image
from binocular_recon.machine import optional_package
from binocular_recon.stereo.foreign.conventions import NetworkConfig


class NetworkError(BinocularReconError):
    """A network does not take an image pair, or gives no disparities."""


@dataclass(frozen=True, eq=False)
class StereoNetwork:
    """A network that takes the left and the right image as two inputs or as one.

    Attributes
    ----------
    path : Path
        Its file.
    session : onnxruntime.InferenceSession
        The loaded network.

    """

    path: Path
    session: Any

    def disparity(self, left: Image, right: Image, config: NetworkConfig) -> FloatImage:
        """Return what the network gives for a pair.

        Parameters
        ----------
        left, right : (H, W, 3) float32
            BGR or grey in three channels, levels 0..255.
        config : NetworkConfig
            The network's conventions.

        Returns
        -------
        (H, W) float32
            x_left - x_right, px; values that are not finite mean none.

        Raises
        ------
        NetworkError
            If the network does not fit the pair or the conventions.

        """
        height, width = left.shape[:2]
        images = [_arranged(image, config) for image in (left, right)]
        inputs = self.session.get_inputs()
        axis = 1 if config.onnx_layout == 'nchw' else 3
        if len(inputs) == 1:
            images = [np.concatenate(images, axis=axis)]
        if len(inputs) > 2:
            names = ', '.join(one.name for one in inputs)
            raise NetworkError(
                f'{self.path} has {len(inputs)} inputs ({names}); it must have two, the left and'
                ' the right image, or one with the channels of both'
            )
        feeds = {}
        for one, image in zip(inputs, images, strict=True):
            if one.type not in _TYPES:
                raise NetworkError(
                    f'{self.path}: input {one.name} is {one.type}; it must be one of'
                    f' {", ".join(_TYPES)}'
                )
            feeds[one.name] = self._fitted(one, image, config).astype(_TYPES[one.type])
        return self._run(feeds, config)[:height, :width]

    def _fitted(self, described: Any, image: Image, config: NetworkConfig) -> Image:
        """Return an image padded to the size that an input takes."""
        shape = described.shape
        if len(shape) != image.ndim:
            raise self._misfit(described, image.shape)
        rows, columns = (2, 3) if config.onnx_layout == 'nchw' else (1, 2)
        padding = [(0, 0)] * image.ndim
        for axis, wanted in enumerate(shape):
            length = image.shape[axis]
            target = length
            if axis in (rows, columns):
                target = -(-length // config.onnx_multiple) * config.onnx_multiple
                if isinstance(wanted, int) and wanted >= length:
                    target = wanted
            if isinstance(wanted, int) and wanted != target:
                raise self._misfit(described, image.shape)
            padding[axis] = (0, target - length)
        return np.pad(image, padding, mode='edge')

    def _misfit(self, described: Any, shape: Sequence[int]) -> NetworkError:
        return NetworkError(
            f'{self.path}: input {described.name} takes {_text(described.shape)} and gets'
            f' {_text(shape)}; set onnx_channels, onnx_layout and onnx_multiple, or crop or resize'
            ' the images'
        )

    def _run(self, feeds: dict[str, Image], config: NetworkConfig) -> FloatImage:
        names = [one.name for one in self.session.get_outputs()]
        if config.onnx_output and config.onnx_output not in names:
            raise NetworkError(
                f'{self.path} has no output {config.onnx_output!r}; it has {", ".join(names)}'
            )
        name = config.onnx_output or names[0]
        try:
            (values,) = self.session.run([name], feeds)
        except Exception as error:  # onnxruntime has no common base of its errors
            raise NetworkError(f'{self.path} cannot be run: {shortened(error)}') from error
        image = next(iter(feeds.values()))
        size = image.shape[2:4] if config.onnx_layout == 'nchw' else image.shape[1:3]
        values = np.asarray(values)
        found = values.reshape([length for length in values.shape if length != 1] or [1])
        if found.ndim == 3 and found.shape == (2, *size):  # a flow: across and down
            found = found[0]
        if found.shape != tuple(size) or found.dtype.kind != 'f':
            raise NetworkError(
                f'{self.path}: output {name} is {values.dtype} of {_text(values.shape)}; it must'
                f' be a disparity for each of {size[0]} rows and {size[1]} columns; choose another'
                f' of its outputs ({", ".join(names)}) by onnx_output'
            )
        if not np.isfinite(found).any():
            raise NetworkError(
                f'{self.path}: output {name} has no finite value; check onnx_scale, onnx_mean and'
                ' onnx_std'
            )
        return found.astype(np.float32) * np.float32(config.onnx_output_scale)


_TYPES = {'tensor(float)': np.float32, 'tensor(float16)': np.float16, 'tensor(uint8)': np.uint8}


def load_network(path: Path) -> StereoNetwork:
    """Return the network of a file, the one in memory if the file has not changed.

    Raises
    ------
    DependencyError
        If onnxruntime is not installed.
    FileError
        If the file cannot be read or is no network that onnxruntime runs.

    """
    runtime = optional_package('onnxruntime', 'networks (matcher onnx)')
    try:
        status = path.stat()
    except OSError as error:
        raise FileError(
            f'{path} cannot be read: {error.strerror}; set onnx_model to the file of a network'
        ) from error
    return _loaded(path, status.st_mtime_ns, thread_count(), runtime)


@lru_cache(maxsize=2)
def _loaded(path: Path, _changed_ns: int, threads: int, runtime: Any) -> StereoNetwork:
    options = runtime.SessionOptions()
    options.intra_op_num_threads = threads
    options.log_severity_level = 4
    try:
        session = runtime.InferenceSession(
            os.fspath(path), options, providers=runtime.get_available_providers()
        )
    except Exception as error:  # onnxruntime has no common base of its errors
        raise FileError(
            f'{path} is damaged, or no network that onnxruntime {runtime.__version__} runs:'
            f' {shortened(error)}'
        ) from error
    return StereoNetwork(path, session)


def _arranged(image: Image, config: NetworkConfig) -> Image:
    """Return an image with a leading axis, in the order and scale that the network takes."""
    if config.onnx_channels == 'grey':
        values = image @ np.array([0.114, 0.587, 0.299], np.float32)
        values = values[..., None]
    else:
        values = image[..., ::-1] if config.onnx_channels == 'rgb' else image
    mean, std = (
        np.array(numbers, np.float32)
        for numbers in (config.onnx_mean_by_channel, config.onnx_std_by_channel)
    )
    values = ((values * np.float32(config.onnx_scale) - mean) / std).astype(np.float32)
    return (values if config.onnx_layout == 'nhwc' else values.transpose(2, 0, 1))[None]


def _text(shape: Sequence[object]) -> str:
    return 'x'.join(map(str, shape))
