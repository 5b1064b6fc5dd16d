"""`python -m sampling_design` is the command line, where no script is on the path."""

from sampling_design.cli import main

if __name__ == "__main__":  # worker processes load this module again
    main()
