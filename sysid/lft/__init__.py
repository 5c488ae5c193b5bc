"""Block-structured models with a static map in a linear network."""

from sysid.lft.linear_block import LinearBlock
from sysid.lft.wiener_hammerstein import fit_wiener_hammerstein
from sysid.lft.wiener_hammerstein_choice import WienerHammersteinChoice, choose_wiener_hammerstein
from sysid.lft.wiener_hammerstein_fit import WienerHammersteinFit
from sysid.lft.wiener_hammerstein_model import WienerHammerstein

__all__ = [
    "LinearBlock",
    "WienerHammerstein",
    "WienerHammersteinChoice",
    "WienerHammersteinFit",
    "choose_wiener_hammerstein",
    "fit_wiener_hammerstein",
]
