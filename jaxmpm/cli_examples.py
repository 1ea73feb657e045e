"""Examples that the help of each command ends with."""

EXAMPLES = {
    "": [
        ("jaxmpm scenes", "what comes with the program"),
        ("jaxmpm run den --set grid.cell=5", "run one of them, changed"),
        ("jaxmpm new plate.toml", "begin a scene of your own"),
        ("jaxmpm run --help", "all options of a command"),
    ],
    "run": [
        ("jaxmpm run den", "results in results/den"),
        ("jaxmpm run plate.toml --out fine --set grid.cell=2.5", "a scene of your own, changed"),
        ("jaxmpm run plate.toml --out fine --resume", "go on with a run that was interrupted"),
        ("jaxmpm run den --format pdf", "pictures for a paper"),
        ("jaxmpm run rve --samples 20 --jobs 2 --out many", "20 random structures, two at a time"),
    ],
    "scenes": [
        ("jaxmpm scenes", "names and titles"),
        ("jaxmpm scenes --sheet scenes.png", "a small picture of each"),
    ],
    "new": [
        ("jaxmpm new plate.toml", "a notched plate to change"),
        ("jaxmpm new mine.toml --like beam", "a copy of a bundled scene"),
    ],
    "schema": [("jaxmpm schema > jaxmpm.schema.json", "for editors of TOML")],
    "completion": [
        ('eval "$(jaxmpm completion bash)"', "in ~/.bashrc"),
        ('eval "$(jaxmpm completion zsh)"', "in ~/.zshrc"),
        ("jaxmpm completion fish > ~/.config/fish/completions/jaxmpm.fish", "once"),
    ],
    "chart": [
        ("jaxmpm chart den --budget 10m", "error against time for cells, rates and solvers, drawn and tabled"),
        ("jaxmpm chart den --budget 10m --resume", "go on with what has been measured"),
    ],
    "size-effect": [("jaxmpm size-effect --out results/size_effect", "sizes 1:16, bands and smeared cracks; a table and a picture")],
    "phases": [
        ("jaxmpm phases plate.toml", "bodies, supports and loads, before a run"),
        ("jaxmpm phases rve --set mesostructure.seed=2 --out two.pdf", "another structure"),
    ],
    "plot": [
        ("jaxmpm plot results/den", "response and cracks again"),
        ("jaxmpm plot results/den --deformed 200 --format pdf", "displacements 200 times as large"),
        ("jaxmpm plot results/den --field stress --frame 3", "stress, some time before the end"),
        ("jaxmpm plot results/brazil --animate", "all frames as a GIF"),
    ],
    "calibrate": [
        ("jaxmpm calibrate energy --E 32000 --ft 3 --GF 0.11 --h 0.05", "Ep and n from GF"),
        ("jaxmpm calibrate curve hordijk_1991 --E 32000 --h 0.05", "from a softening curve"),
        ("jaxmpm calibrate specimen beam --free concrete.ft --free concrete.GF", "from a test"),
    ],
    "calibrate energy": [
        ("jaxmpm calibrate energy --E 32000 --ft 3 --GF 0.11 --h 0.05", "initial slope 2 ft²/GF"),
        ("jaxmpm calibrate energy --E 32000 --ft 3 --GF 0.11 --h 0.05 --condition point --w 0.03", "half of ft at 0.03 mm"),
    ],
    "calibrate curve": [
        ("jaxmpm calibrate curve tests.csv --E 32000 --h 0.05 --out fit", "the damage law; fit/fit.png"),
        ("jaxmpm calibrate curve hordijk_1991 --law exponential --fix GF=0.11", "a cohesive law, its energy known"),
    ],
    "calibrate specimen": [
        ("jaxmpm calibrate specimen beam --free concrete.ft --free concrete.GF --out fit", "to the scene's reference"),
        ("jaxmpm calibrate specimen den --free concrete.ft --set grid.cell=5 --twin 0.02", "what a test can tell"),
    ],
    "verify": [
        ("jaxmpm verify", "everything, many minutes"),
        ("jaxmpm verify uniaxial tangent patch", "some"),
        ("jaxmpm verify multigrid", "how steps of the linear solver grow with the grid, and what 640 x 640 cells take"),
        ("jaxmpm verify opening --angle 22.5 --cell 1.25", "one opening test"),
    ],
    "stability": [
        ("jaxmpm stability --coarse --out map", "a quick map: map/stability.png"),
        ("jaxmpm stability --page", "time steps, cell crossing, locking, rates, float32, H_max: results/stability/stability_page.png"),
        ("jaxmpm stability --page --only cfl locking --resume", "some of it, all else as it was measured before"),
    ],
    "benchmark": [
        ("jaxmpm benchmark den --cells 5 2.5", "ms a step, cell-steps/s, memory"),
        ("jaxmpm benchmark points", "cracked points a second"),
    ],
}
