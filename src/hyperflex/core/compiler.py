"""Compilation of a kernel by numba. The only module that uses private interfaces of numba.

A kernel that Python calls is a *door*, one that kernels call a *part*; the same function may be both. Plain numba
optimises each kernel, generates its machine code and wraps it for Python, and repeats this for all its callees within
each caller. Here a part is only translated to LLVM IR. A door is linked with all parts that it needs, then optimised
and compiled to machine code once. This takes half of the time and gives the same code.

Both are cached on disk, see :mod:`hyperflex.core.cache`.
"""

import functools
import gc
import pickle
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from llvmlite import binding as llvm
from numba.core import compiler, event, serialize
from numba.core.codegen import JITCodeLibrary
from numba.core.imputils import impl_ret_borrowed
from numba.core.registry import CPUDispatcher
from numba.core.types import Dispatcher, UniTuple, intp, unliteral, void  # type: ignore[attr-defined]
from numba.core.types.functions import BaseFunction
from numba.core.typing.templates import _OverloadFunctionTemplate
from numba.extending import intrinsic

from hyperflex.core import cache


@intrinsic
def read_only(_context: Any, array: Any) -> Any:
    """Return a kernel's own array with the read-only type of its callers' arrays."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return impl_ret_borrowed(context, builder, signature.return_type, arguments[0])

    return array.copy(readonly=True)(array), generate


CACHE_LINE = 64  # bytes


def _slots(context: Any, builder: Any, signature: Any, row: Any, width: Any, at: Any, slots: Any) -> list[Any]:
    """Return pointers to the numbers in some slots of a row, see :func:`read_slots`.

    Loops over lanes keep packed numbers on the stack. The stack is aligned to a cache line, because packed loads that
    cross one cost a tenth of the speed, and LLVM does not align spilled values.
    """
    attributes = builder.function.attributes
    attributes.alignstack = CACHE_LINE
    attributes.add("nounwind")  # llvmlite writes the alignment only of a function with another attribute
    data = context.make_array(signature.args[0])(context, builder, row).data
    offsets = (builder.mul(width, builder.extract_value(slots, k)) for k in range(len(signature.args[3])))
    return [builder.gep(data, [builder.add(at, offset)]) for offset in offsets]


@intrinsic
def read_slots(_context: Any, row: Any, _width: Any, _at: Any, slots: Any) -> Any:
    """Return the numbers of a row at ``at + slot * width``, for a tuple of slots."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        numbers = map(builder.load, _slots(context, builder, signature, *arguments))
        return context.make_tuple(builder, signature.return_type, list(numbers))

    integers = UniTuple(intp, len(slots))
    return UniTuple(row.dtype, len(slots))(row, intp, intp, integers), generate


@intrinsic
def write_slots(_context: Any, row: Any, _width: Any, _at: Any, slots: Any, values: Any) -> Any:
    """Write a tuple of numbers to the slots of :func:`read_slots`."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        for k, place in enumerate(_slots(context, builder, signature, *arguments[:4])):
            builder.store(builder.extract_value(arguments[4], k), place)
        return context.get_dummy_value()

    return void(row, intp, intp, UniTuple(intp, len(slots)), UniTuple(row.dtype, len(values))), generate


class Timer(event.Listener):  # type: ignore[misc]
    """Sum of the compile time; a function's callees are compiled within its own compilation."""

    def __init__(self, announce: Callable[[], None]) -> None:
        self.spent, self._depth, self._since, self._announce = 0.0, 0, 0.0, announce
        event.register("numba:compile", self)

    def on_start(self, _event: event.Event) -> None:
        """Record the start of the outermost compilation."""
        if self._depth == 0:
            self._since = time.monotonic()
            self._announce()
        self._depth += 1

    def on_end(self, _event: event.Event) -> None:
        """Add its duration."""
        self._depth -= 1
        if self._depth == 0:
            self.spent += time.monotonic() - self._since


class Door(CPUDispatcher):  # type: ignore[misc]
    """A kernel for Python, compiled on its first call; kernels that call it get its part instead.

    `py_func` is a function of a module (not within another function), `targetoptions` are those of ``numba.njit``, and
    ``_nrt``, whether references to its own arrays are counted.
    """

    def __init__(self, py_func: Callable[..., Any], *arguments: Any, **named: Any) -> None:
        super().__init__(py_func, *arguments, **named)
        self._cache = _Kept(py_func, "door", compiler.CompileResult._reduce, compiler.CompileResult._rebuild)

    @functools.cached_property
    def part(self) -> Any:
        """The part of this kernel, for calling kernels."""
        options = {**self.targetoptions, "no_cpython_wrapper": True}
        part = _PartDispatcher(self.py_func, targetoptions=options, pipeline_class=_PartCompiler)
        part._cache = _Kept(self.py_func, "part", _pack_part, _unpack_part)
        return part

    @property
    def _numba_type_(self) -> Any:
        return Dispatcher(self.part)

    def compile(self, sig: Any) -> Any:
        """Compile the kernel for a signature, like numba."""
        with _economical():
            return _with_room(super().compile, sig)


class _PartDispatcher(CPUDispatcher):  # type: ignore[misc]
    """A kernel for kernels. Unlike in numba, a literal number in a call does not create another specialisation."""

    def get_call_template(self, args: Any, kws: Any) -> Any:
        return super().get_call_template(
            tuple(map(unliteral, args)), {name: unliteral(each) for name, each in kws.items()}
        )


def _part_decorator(template: Any) -> Any:
    """Return the decorator of implementations of builtins such as ``np.zeros``: like a part, without machine code."""
    return functools.partial(_jit_decorator(template), pipeline_class=_PartCompiler, no_cfunc_wrapper=True)


@contextmanager
def _economical() -> Iterator[None]:
    """Resolve each builtin operation once, and run the garbage collector less often while compiling."""
    was = gc.get_threshold()
    gc.set_threshold(20_000, 20, 100)
    _Function.get_call_type, _Overload._get_jit_decorator = _remembered_type, _part_decorator
    try:
        yield
    finally:
        gc.set_threshold(*was)
        _Function.get_call_type, _Overload._get_jit_decorator = _call_type, _jit_decorator


_Function: Any = BaseFunction
_call_type: Any = BaseFunction.get_call_type
_Overload: Any = _OverloadFunctionTemplate
_jit_decorator: Any = _OverloadFunctionTemplate._get_jit_decorator


def _remembered_type(function: Any, context: Any, args: tuple[Any, ...], kws: dict[str, Any]) -> Any:
    """Return the signature of a call like numba, which tries a dozen overloads for each ``x + y``.

    It is cached by the types of the arguments, except for overloads, which depend on compile options.
    """
    known = function.__dict__.setdefault("_signatures", {})
    if kws or args not in known:
        signature = _call_type(function, context, args, kws)
        if kws or function._impl_keys[signature.args] is not function.typing_key:
            return signature
        known[args] = signature
    return known[args]


def _with_room(function: Callable[[Any], Any], argument: Any) -> Any:
    return function(argument)


# Python keeps call frames in chunks of 16 kB, and allocates and frees one each time a call crosses the end of a chunk:
# a fifth of the time in the deep calls of the compiler. A frame that needs more gets a large chunk, in which all deeper
# calls fit.
_with_room.__code__ = _with_room.__code__.replace(co_stacksize=1 << 17)


class _Part(JITCodeLibrary):  # type: ignore[misc]
    """A kernel in LLVM IR with all its callees, to be linked into others, not to be run."""

    def finalize(self) -> None:
        self._raise_if_finalized()
        for library in dict.fromkeys(self._linking_libraries):
            self._reload_init.update(library._reload_init)
            self._final_module.link_in(library._get_module_for_linking(), preserve=True)
        self._finalize_dynamic_globals()
        for each in self._final_module.functions:
            if not each.is_declaration and each.linkage == llvm.Linkage.external:
                each.linkage = "linkonce_odr"  # several linked modules may contain it
        self._finalized = True

    def _get_module_for_linking(self) -> Any:
        self._ensure_finalized()
        return self._final_module


class _PartCompiler(compiler.Compiler):  # type: ignore[misc]
    """Numba's pipeline without the generation of machine code."""

    def define_pipelines(self) -> list[Any]:
        self.state.library = _Part(self.state.targetctx.codegen(), self.state.func_id.func_qualname)
        self.state.flags.no_compile = True
        return [compiler.DefaultPassBuilder.define_nopython_pipeline(self.state)]

    def compile_extra(self, func: Callable[..., Any]) -> Any:
        made = super().compile_extra(func)._replace(entry_point=_name_of_its_own())
        self.state.targetctx.insert_user_function(made.entry_point, made.fndesc, [made.library])
        return made


def _name_of_its_own() -> Any:
    """Return the key by which numba finds a part: a unique function of the expected kind, which is never called."""
    return [].append


class _Kept:
    """The cache of one kernel, with numba's interface.

    Parameters
    ----------
    function : callable
        The Python function of the kernel.
    kind : {"door", "part"}
        Kind of compilation.
    pack, unpack : callable
        Convert a compiled kernel to an object that can be pickled, and back.
    """

    def __init__(self, function: Callable[..., Any], kind: str, pack: Any, unpack: Any) -> None:
        self._name = f"{function.__module__}.{function.__qualname__}-{kind}"
        self._pack, self._unpack = pack, unpack

    @property
    def cache_path(self) -> Path:
        """The folder of all kernels."""
        return cache.kernels_folder()

    def _key(self, argument_types: Any, codegen: Any) -> str:
        return repr((argument_types, codegen.magic_tuple()))

    def load_overload(self, argument_types: Any, context: Any) -> Any:
        """Return the compiled kernel for such types of arguments, None if no usable one exists."""
        context.refresh()
        packed = cache.load(self._name, self._key(argument_types, context.codegen()))
        return None if packed is None else self._unpack(context, *pickle.loads(packed))

    def save_overload(self, argument_types: Any, made: Any) -> None:
        """Save a compiled kernel; if this fails, the next process compiles it again."""
        packed = serialize.dumps(self._pack(made))
        cache.save(self._name, self._key(argument_types, made.library.codegen), packed)


def _pack_part(made: Any) -> Any:
    made.fndesc.typemap = made.fndesc.calltypes = None  # no longer needed, and cannot be pickled
    module = made.library._get_module_for_linking().as_bitcode()
    return made.library.name, module, made.fndesc, made.signature, tuple(made.library._reload_init)


def _unpack_part(context: Any, name: str, module: bytes, fndesc: Any, signature: Any, reload_init: Any) -> Any:
    library = _Part(context.codegen(), name)
    library._final_module = llvm.parse_bitcode(module)
    library._reload_init.update(reload_init)
    library._finalized = True
    return compiler.compile_result(
        typing_context=context.typing_context,
        target_context=context,
        entry_point=_name_of_its_own(),
        library=library,
        fndesc=fndesc,
        signature=signature,
        objectmode=False,
        lifted=(),
        reload_init=list(reload_init),
    )
