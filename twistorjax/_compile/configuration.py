"""Settings of JAX for this library."""

import contextlib
import math
import os
from pathlib import Path

import jax

from .._utils.progress import set_enabled
from .._utils.validation import warn
from .compilation import add_xla_option, FAST_COMPILATION, FAST_LOOPS
from .stored_traces import store_traces_in


def configure(
    *,
    cache: bool | str | Path = True,
    cache_size: int = 10**9,
    shared_cache: bool = False,
    fast_compilation: bool = True,
    fast_loops: bool = True,
    progress: bool | None = None,
    debug: bool = False,
) -> None:
    """Enable double precision, options of XLA, and a cache of programs on disk.

    Call this function once, before arrays are created. JAX compiles a program for each
    kind of problem, which takes seconds. With the cache, later processes load the program
    in a fraction of this time. Several processes may use the cache at the same time.

    The folder also has the traced functions of this library, so that later processes do
    not trace them again. They are stored if all classes and functions in their arguments
    are those of this library and of the packages that it uses. If you replace functions
    of this library while a process runs, use `cache=False`.

    The options of XLA are for processors. They are added to the environment variable
    `XLA_FLAGS`, if they are not there. They act on all programs of this process, if JAX
    has not created an array yet.

    Args:
        cache: Whether programs are stored in the cache folder of the user, which is
            `~/.cache/twistorjax` on Linux; or the path of another folder, which must not
            have been used without a limit of its size. A folder that is already set, for
            example by the environment variable `JAX_COMPILATION_CACHE_DIR`, is kept, with
            its limit of compiled programs.
        cache_size: Largest size of the folder; bytes. The programs that have not been
            used for the longest time are deleted first.
        shared_cache: Whether several users share the folder. Whoever may write into it
            can then change your results and run any code with your permissions. By
            default, traced functions are loaded only if nobody but you may change them;
            JAX does not check this for its compiled programs. The size of a shared folder
            has no limit.
        fast_compilation: Whether XLA compiles programs without its fusion emitters, which
            takes about 40 % less time. The programs of this library run as fast; those of
            other libraries may be slower. JAX 0.11 does not have this option.
        fast_loops: Whether XLA compiles each loop over small arrays to one function
            instead of many. A motion then takes 25 % less time, its gradient less than
            half the time, and an equilibrium 20 % less time. The gradient of a motion
            compiles in 10 % more time.
        progress: Whether work that takes longer than two seconds is named in a line on
            the terminal or in the notebook, which disappears at its end. By default only
            if stderr is a terminal, or in a notebook.
        debug: Whether the functions of this library run line by line in Python instead
            of as compiled programs, so that a breakpoint in any of them is reached in
            each call, and values can be printed, also in the energy of one hinge, where
            JAX prints a value as `GradTracer(primal=0.05)` if it differentiates. Each
            operation is then compiled on its own, and a call takes seconds or minutes.
            There is no cache. It ends with the process, or with `jax_disable_jit` of JAX.

    Raises:
        ValueError: The size is not positive.

    Example:
        >>> configure(cache=False)  # double precision only
        >>> jax.numpy.zeros(2)
        Array([0., 0.], dtype=float64)
    """
    if cache_size <= 0:
        raise ValueError(f"`cache_size` is {cache_size!r}, but must be positive; bytes.")
    jax.config.update("jax_enable_x64", True)
    set_enabled(progress)
    if debug:
        jax.config.update("jax_disable_jit", True)
        store_traces_in(None)
        return
    if fast_compilation:
        add_xla_option(FAST_COMPILATION)
    if fast_loops:
        add_xla_option(FAST_LOOPS)
    folder = getattr(jax.config, "jax_compilation_cache_dir", None)
    if cache is False:
        store_traces_in(None)
    elif cache is not True or not folder:
        _use_folder(cache, cache_size, shared_cache)
    elif "://" not in folder:  # JAX also accepts the address of a storage service.
        with contextlib.suppress(OSError):  # JAX reports it.
            Path(folder).mkdir(parents=True, exist_ok=True)
            store_traces_in(Path(folder) / "traces", shared=shared_cache)
        _store_short_programs(Path(folder))


def _use_folder(cache: bool | str | Path, size: int, shared: bool) -> None:
    """Store programs and traces in a folder, or nowhere if it cannot be created."""
    import platformdirs

    default = platformdirs.user_cache_path("twistorjax") / "programs"
    folder = default if isinstance(cache, bool) else Path(cache)
    try:
        if folder is default and not folder.is_absolute():
            raise FileNotFoundError("the user has no home folder")
        folder.mkdir(parents=True, exist_ok=True)
        is_own = not hasattr(os, "geteuid") or folder.stat().st_uid == os.geteuid()
    except OSError as error:
        warn(
            f"The cache folder {str(folder)!r} cannot be used: {error}. Nothing is "
            "stored. `cache` can be another folder, or False."
        )
        jax.config.update("jax_compilation_cache_dir", None)
        store_traces_in(None)
        return
    # To limit its size, JAX writes into files that belong to the first user.
    limited = is_own and not shared and os.access(folder, os.W_OK)
    jax.config.update("jax_compilation_cache_dir", str(folder))
    jax.config.update("jax_compilation_cache_max_size", size * 9 // 10 if limited else -1)
    _store_short_programs(folder)
    store_traces_in(folder / "traces", size // 10, shared=shared)


def _store_short_programs(folder: Path) -> None:
    """Let JAX store all programs, also short ones; none if the folder is read-only."""
    read_only = folder.is_dir() and not os.access(folder, os.W_OK)
    shortest = math.inf if read_only else 0.0  # of the stored programs; s
    jax.config.update("jax_persistent_cache_min_compile_time_secs", shortest)
