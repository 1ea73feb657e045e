"""Times the codes side by side on one scene; `python -m tests.benchmarks` prints the table."""
