"""`--device` of what trains a network: the CPU, or a GPU."""

import os

from capture_cli.errors import OptionError


def torch_device(device: str, threads: int) -> str:
    """The device as torch, which gets so many `threads` of the CPU, names it; "auto" is a GPU where there is one.

    device: "auto", "cpu" or "cuda". Raises OptionError where there is no GPU, and one is asked for.
    """
    # threads that wait must sleep: beside other work, spinning ones have cost a factor of 40
    os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")
    import torch  # reads that setting

    torch.set_num_threads(threads)
    there = torch.cuda.is_available()
    if device == "cuda" and not there:
        built = "finds no GPU" if torch.backends.cuda.is_built() else "was built without CUDA"
        raise OptionError(
            f"--device cuda: torch {torch.__version__} {built}",
            cure="use --device cpu (or auto), or install the driver and a CUDA build of torch",
        )
    return "cuda" if there and device != "cpu" else "cpu"
