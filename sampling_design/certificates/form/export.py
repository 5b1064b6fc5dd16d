"""Every constant of a certificate with its formula and source, for markdown and LaTeX."""

from __future__ import annotations

from typing import Protocol

from sampling_design.certificates.form.constants import Constant, ConstantList
from sampling_design.certificates.form.horizon import Horizon

_SHARP = "sharper horizon theorem"
_PAPER = "Theorem 9"


class HasConstants(Protocol):
    """A certificate about samples: rate, lambdas, margin and horizons."""

    @property
    def eta(self) -> float: ...
    @property
    def lam(self) -> float: ...
    @property
    def lam_samples(self) -> float: ...
    @property
    def margin(self) -> float: ...
    def horizon(self, theorem: str) -> Horizon:
        """The least horizon and its gains."""


def constants_of(certificate: HasConstants) -> ConstantList:
    """Return the constants of a certificate: rate, lambdas, and both horizons with their gains.

    Parameters
    ----------
    certificate : Certificate

    Returns
    -------
    ConstantList
    """
    c = certificate
    first = [
        Constant("eta", c.eta, r"\eta", "Assumption 7", r"\eta"),
        Constant("lam", c.lam, r"\sup_{s, t} \lambda_{\max}(P_2, \Pi_s(t))", "all real starts", r"\lambda"),
        Constant(
            "lam_samples", c.lam_samples, r"\sup_{i, t} \lambda_{\max}(P_2, \Pi_i(t))", "sample starts", r"\lambda_K"
        ),
        Constant("margin", c.margin, r"\Pi \succeq (1 + m) P_1", "verified", "m"),
    ]
    return ConstantList([*first, *_sharp(c.horizon("sharp")), *_paper(c.horizon("paper"))])


def _sharp(h: Horizon) -> list[Constant]:
    low = r"\lambda_{\min}(P_1)"
    return [
        Constant("sharp_minimum", h.minimum, r"M > \ln(\lambda)/\eta", _SHARP, "M"),
        Constant("sharp_length", h.length, r"\max(d_{\max}, \ln(4\lambda)/\eta)", "default", "M"),
        Constant("sharp_eta_tilde", h.eta_tilde, r"\eta - \ln(\lambda)/M", _SHARP, r"\tilde\eta"),
        Constant("sharp_C_x", h.C_x, rf"\lambda_{{\max}}(P_2)/{low}", _SHARP, "C_x"),
        Constant("sharp_C_w", h.C_w, rf"\lambda_{{\max}}(Q_w)/{low}", _SHARP, "C_w"),
        Constant("sharp_C_v", h.C_v, rf"\lambda_{{\max}}(\tilde R)/{low}", _SHARP, "C_v"),
    ]


def _paper(h: Horizon) -> list[Constant]:
    low = r"\lambda_{\min}(P_2/\lambda_K)"
    return [
        Constant("paper_minimum", h.minimum, r"M > 2\ln(2\lambda_K)/\eta", _PAPER, "M"),
        Constant("paper_length", h.length, r"\max(d_{\max}, 2\ln(4\lambda_K)/\eta)", "default", "M"),
        Constant("paper_eta_tilde", h.eta_tilde, r"\eta - \ln(4\lambda_K^2)/M", _PAPER, r"\tilde\eta"),
        Constant("paper_C_x", h.C_x, rf"4\lambda_K\lambda_{{\max}}(P_2)/{low}", _PAPER, "C_x"),
        Constant("paper_C_w", h.C_w, rf"4\lambda_K\lambda_{{\max}}(Q_w)/{low}", _PAPER, "C_w"),
        Constant("paper_C_v", h.C_v, rf"8\lambda_K\lambda_{{\max}}(Q_v)/{low}", _PAPER, "C_v"),
    ]
