/* Search results show formulas as people read them, not as TeX. */
"use strict";
(() => {
  const named = {
    alpha: "α", beta: "β", gamma: "γ", delta: "δ", epsilon: "ε", varepsilon: "ε", eta: "η", theta: "θ", kappa: "κ",
    lambda: "λ", mu: "μ", nu: "ν", xi: "ξ", pi: "π", rho: "ρ", sigma: "σ", tau: "τ", phi: "φ", varphi: "φ", chi: "χ",
    omega: "ω", Delta: "Δ", Gamma: "Γ", Lambda: "Λ", Phi: "Φ", Pi: "Π", Sigma: "Σ", Omega: "Ω", le: "≤", ge: "≥",
    leq: "≤", geq: "≥", ne: "≠", in: "∈", ni: "∋", subseteq: "⊆", cup: "∪", cap: "∩", emptyset: "∅", infty: "∞",
    preceq: "⪯", succeq: "⪰", prec: "≺", succ: "≻", to: "→", mapsto: "↦", int: "∫", sum: "Σ", prod: "Π", sup: "sup",
    inf: "inf", min: "min", max: "max", ln: "ln", exp: "exp", cdot: "·", cdots: "…", dots: "…", ldots: "…", circ: "∘",
    times: "×", pm: "±", approx: "≈", equiv: "≡", square: "∎", Box: "∎", quad: " ", qquad: " ", langle: "⟨",
    rangle: "⟩", lvert: "|", rvert: "|", lVert: "‖", rVert: "‖", lfloor: "⌊", rfloor: "⌋", lceil: "⌈", rceil: "⌉",
    nabla: "∇", partial: "∂", forall: "∀", exists: "∃", sim: "~", star: "*", ast: "*", prime: "′", ell: "ℓ",
    operatorname: "", mathrm: "", mathbb: "", mathcal: "", text: "", bar: "", hat: "", tilde: "", dot: "", ddot: "",
    left: "", right: "", big: "", Big: "", bigl: "", bigr: "", sqrt: "√", Re: "Re", Im: "Im",
  };
  const words = (tex) =>
    tex
      .replace(/\\begin\{.*?\}(\{.*?\})?|\\end\{.*?\}|\\tag\{.*?\}|\\label\{.*?\}|\\\\|&/gs, " ")
      .replace(/^\s*\\[([]|\\[\])]\s*$/g, "")
      .replace(/\\t?frac\s*(\d)(\d)/g, "$1/$2")
      .replace(/\\t?frac\{([^{}]*)\}\{([^{}]*)\}/g, "($1)/($2)")
      .replace(/\\([A-Za-z]+)\s?/g, (_, name) => (name in named ? named[name] : name))
      .replace(/\\[,;:! ]/g, " ")
      .replace(/\\([|{}%_&#$])/g, "$1")
      .replace(/[{}$\\]/g, "")
      .replace(/\s+/g, " ")
      .trim();
  const plain = (html) => {
    const page = new DOMParser().parseFromString(html, "text/html");
    page.querySelectorAll(".math").forEach((node) => (node.textContent = words(node.textContent)));
    page.querySelectorAll('script, style, svg, [type^="application/"]').forEach((node) => node.remove());
    return page.documentElement.outerHTML;
  };
  if (typeof Search !== "undefined") {
    const before = Search.htmlToText;
    Search.htmlToText = (html, anchor) => before(plain(html), anchor);
  }
})();
