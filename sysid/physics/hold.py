"""What the input does between samples: it is held, or follows a smooth curve through the samples."""

import numpy as np

from sysid.linear.forms import Floats
from sysid.physics.linear_form import Discrete

HOLDS = ("zero", "smooth")
# A smooth input is a staircase of so many steps between samples, each as high as the spline at its middle.
PIECES = 4


def refined(signal: Floats, axis: int = 0) -> Floats:
    """Return a smooth signal in pieces: `PIECES` times as many rows, the last sample held.

    Examples
    --------
    >>> import numpy as np
    >>> refined(np.arange(3.0)).tolist()
    [0.125, 0.375, 0.625, 0.875, 1.125, 1.375, 1.625, 1.875, 2.0, 2.0, 2.0, 2.0]
    """
    from sysid.physics.hold_kernels import between_samples

    moved = np.moveaxis(np.asarray(signal, dtype=float), axis, -1)
    shape = (*moved.shape[:-1], moved.shape[-1] * PIECES)
    lines = np.ascontiguousarray(moved).reshape(-1, moved.shape[-1])
    middles = (np.arange(PIECES) + 0.5) / PIECES
    return np.ascontiguousarray(np.moveaxis(between_samples(lines, middles).reshape(shape), -1, axis))


def in_columns(signal: Floats, axis: int = 0) -> Floats:
    """Return what drives a recursion over whole samples: the pieces of each input, then the inputs.

    The last axis, of the inputs, becomes ``n_inputs * PIECES + n_inputs`` long.
    """
    pieces = refined(signal, axis)
    shape = list(signal.shape)
    shape[axis : axis + 1] = [shape[axis], PIECES]
    pieces = np.moveaxis(pieces.reshape(shape), axis + 1, -1)
    return np.concatenate([pieces.reshape(*signal.shape[:-1], signal.shape[-1] * PIECES), signal], axis=-1)


def over_pieces(piece: Discrete, count: int = PIECES) -> Discrete:
    """Return the recursion over so many pieces, driven by `in_columns` and a constant, from that over one."""
    A, dA = [np.eye(piece.A.shape[0])], [np.zeros_like(piece.A_slopes)]
    for _ in range(count):
        dA.append(piece.A_slopes @ A[-1] + piece.A @ dA[-1])
        A.append(piece.A @ A[-1])
    m = piece.B.shape[1] - 1
    # The first piece acts longest; those to come do not act.
    B = [A[count - 1 - i] @ piece.B for i in range(count)]
    dB = [dA[count - 1 - i] @ piece.B + A[count - 1 - i] @ piece.B_slopes for i in range(count)]
    B += [np.zeros_like(piece.B)] * (PIECES - count)
    dB += [np.zeros_like(piece.B_slopes)] * (PIECES - count)
    return Discrete(
        A[-1],
        _arranged(B, m),
        piece.C,
        np.concatenate([np.zeros((piece.D.shape[0], m * PIECES)), piece.D], axis=-1),
        dA[-1],
        _arranged(dB, m),
        piece.C_slopes,
        np.concatenate([np.zeros((*piece.D_slopes.shape[:2], m * PIECES)), piece.D_slopes], axis=-1),
    )


def _arranged(pieces: list[Floats], m: int) -> Floats:
    """Return the columns of the pieces of each input, none for the inputs themselves, and the constant's."""
    inputs = np.stack([B[..., :m] for B in pieces], axis=-1)
    constant = sum(B[..., m:] for B in pieces)
    shape = inputs.shape[:-2]
    width = inputs.shape[-2] * PIECES
    return np.ascontiguousarray(
        np.concatenate([inputs.reshape(*shape, width), np.zeros((*shape, m)), constant], axis=-1)
    )
