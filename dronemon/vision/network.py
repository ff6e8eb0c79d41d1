"""Networks in ONNX files: through onnxruntime where it is installed, else through OpenCV.

Only onnxruntime tells what a file says of itself: its input's size and the names of its classes.
"""

from __future__ import annotations

import ast
import importlib
import re
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Protocol

import cv2
import numpy as np
from numpy.typing import NDArray

from dronemon.errors import CameraError, OptionError

EXTRA = "pip install 'dronemon[detector]'"
"""What installs onnxruntime."""
_MOST_BYTES = 2**30
Shape = tuple[int | None, int | None, int | None]


class Network(Protocol):
    """A network that takes one picture.

    shape: (3,) channels, height and width of its input, None where the file leaves them open
    names: of its classes, in their order; empty where the file does not tell
    """

    shape: Shape
    names: tuple[str, ...]

    def run(self, picture: NDArray[np.float32]) -> list[NDArray[np.float32]]:
        """Its outputs for (1, channels, height, width). Raises CameraError."""


def open_network(path: Path) -> Network:
    """The network of a file. Raises OptionError."""
    try:
        if path.stat().st_size > _MOST_BYTES:
            raise OptionError(f"{path}: larger than any detector, {_MOST_BYTES // 2**20} MiB")
    except OSError as exc:
        raise OptionError(
            f"{path}: {exc.strerror}; detector.file names an ONNX file, from the mission's folder"
        ) from exc
    try:
        runtime = importlib.import_module("onnxruntime")
    except ImportError:
        return _OpenCv(path)
    return _OnnxRuntime(path, runtime)


class _OnnxRuntime:
    def __init__(self, path: Path, runtime: Any) -> None:
        self._path = path
        options = runtime.SessionOptions()
        options.log_severity_level = 4  # only what ends it
        available = runtime.get_available_providers()
        try:
            self._session = runtime.InferenceSession(path, options, providers=available)
            inputs = [(one.name, one.type, one.shape) for one in self._session.get_inputs()]
            names = self._session.get_modelmeta().custom_metadata_map.get("names", "")
        except Exception as exc:
            raise _unreadable(path, exc) from exc
        if len(inputs) != 1 or len(inputs[0][2]) != 4:
            told = ", ".join(f"{name} {shape}" for name, _, shape in inputs)
            raise OptionError(f"{path}: its inputs are {told}; a detector has one, a picture")
        self._input, kind, (batch, *shape) = inputs[0]
        if kind != "tensor(float)" or (isinstance(batch, int) and batch != 1):
            raise OptionError(
                f"{path}: takes {batch} pictures of {kind}; export it for 1 of tensor(float)"
            )
        channels, height, width = (n if isinstance(n, int) else None for n in shape)
        self.shape: Shape = channels, height, width
        self.names = _names(names)

    def run(self, picture: NDArray[np.float32]) -> list[NDArray[np.float32]]:
        try:
            outputs: list[NDArray[np.float32]] = self._session.run(None, {self._input: picture})
        except Exception as exc:
            raise _failed(self._path, picture, exc) from exc
        if not all(isinstance(of, np.ndarray) and of.dtype.kind in "fiu" for of in outputs):
            raise CameraError(f"{self._path}: puts out something else than tables of numbers")
        return outputs


class _OpenCv:
    def __init__(self, path: Path) -> None:
        self._path = path
        # A damaged file may end the process that reads it.
        code = "import cv2, sys; cv2.dnn.readNetFromONNX(sys.argv[1])"
        trial = subprocess.run(
            [sys.executable, "-c", code, str(path)], capture_output=True, check=False
        )
        if trial.returncode < 0:
            raise _unreadable(path, ValueError("it is damaged"))
        try:
            self._net = cv2.dnn.readNetFromONNX(str(path))
        except cv2.error as exc:
            raise _unreadable(path, exc) from exc
        self._outputs: Sequence[str] = self._net.getUnconnectedOutLayersNames()
        self.shape: Shape = None, None, None
        self.names: tuple[str, ...] = ()

    def run(self, picture: NDArray[np.float32]) -> list[NDArray[np.float32]]:
        try:
            self._net.setInput(picture)
            return [np.asarray(of, np.float32) for of in self._net.forward(self._outputs)]
        except cv2.error as exc:
            raise _failed(self._path, picture, exc) from exc


def _unreadable(path: Path, exc: Exception) -> OptionError:
    why = re.sub(r"\s+", " ", str(exc))
    return OptionError(f"{path}: no ONNX file that can be read: {why:.300}")


def _failed(path: Path, picture: NDArray[np.float32], exc: Exception) -> CameraError:
    _, channels, height, width = picture.shape
    why = re.sub(r"\s+", " ", str(exc))
    return CameraError(
        f"{path}: failed on a picture of {width} x {height} pixels and {channels} channels: "
        f"{why:.300}"
    )


def _names(text: str) -> tuple[str, ...]:
    """Names of classes as exporters write them: a list, or a dictionary by number."""
    try:
        told = ast.literal_eval(text)
    except (ValueError, TypeError, SyntaxError, MemoryError, RecursionError):
        return ()
    if isinstance(told, dict):
        told = [told.get(number) for number in range(len(told))]
    is_list = isinstance(told, list | tuple) and all(isinstance(name, str) for name in told)
    return tuple(told) if is_list else ()
