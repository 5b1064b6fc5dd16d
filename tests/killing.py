"""Jobs that kill the process that does them; light, since new processes import them."""

import os


def squared_unless_killed(job):
    """Kill this process once, for the job with number 3."""
    number, mark = job
    if number == 3 and not os.path.exists(mark):
        open(mark, "w").close()
        os._exit(1)
    return number**2


def killed(job):
    os._exit(1)
