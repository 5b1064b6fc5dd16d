"""docs/theory/modes.md: how many modes of large plants are retained."""

from sampling_design.plants import library
from sampling_design.plants.sparse import split_sparse
from tests.docs.figures import Figure

ROW = r"\| `library\.{}\([\d_]+\)`, .* \| 10 000 \| (\d+) \|"


def retained(plant, decay_rate):
    assert plant.n_states == 10_000
    return (split_sparse(plant, decay_rate=decay_rate).retained.n_states,)


FIGURES = (
    Figure("theory/modes.md", ROW.format("heat_plate"), lambda: retained(library.heat_plate(100), 0.3), slow=True),
    Figure(
        "theory/modes.md", ROW.format("droop_network"), lambda: retained(library.droop_network(10_000), 0.02), slow=True
    ),
)
