"""How numba compiles a kernel. The one place that uses what numba does not promise to keep.

A kernel that Python calls is a *door*, one that kernels call a *part*; the same function may be both. Numba alone
optimises each kernel, makes machine code of it and wraps it for Python, and does so again for all it calls within each
caller. Here a part is only translated to LLVM's language. A door is linked with all the parts that it needs, and
optimised and turned into machine code once. That takes half of the time and gives the same code.

Both are kept on disk, see :mod:`hyperflex.core.cache`.
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
    """Return an array that a kernel has made as one of the kind that its callers give: not to be written to."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return impl_ret_borrowed(context, builder, signature.return_type, arguments[0])

    return array.copy(readonly=True)(array), generate


CACHE_LINE = 64  # bytes


def _slots(context: Any, builder: Any, signature: Any, row: Any, width: Any, at: Any, slots: Any) -> list[Any]:
    """Return pointers to the numbers in some slots of a row, see :func:`read_slots`.

    Loops over lanes keep packed numbers on the stack. The stack begins at a cache line there, because packed loads that
    cross one cost a tenth of the speed, and LLVM does not align what it spills.
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
    """Write a tuple of numbers where :func:`read_slots` reads them."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        for k, place in enumerate(_slots(context, builder, signature, *arguments[:4])):
            builder.store(builder.extract_value(arguments[4], k), place)
        return context.get_dummy_value()

    return void(row, intp, intp, UniTuple(intp, len(slots)), UniTuple(row.dtype, len(values))), generate


class Timer(event.Listener):  # type: ignore[misc]
    """Adds up the time that the compiler takes; it compiles one function at a time, and what that calls within it."""

    def __init__(self, announce: Callable[[], None]) -> None:
        self.spent, self._depth, self._since, self._announce = 0.0, 0, 0.0, announce
        event.register("numba:compile", self)

    def on_start(self, _event: event.Event) -> None:
        """Note when the first of them begins."""
        if self._depth == 0:
            self._since = time.monotonic()
            self._announce()
        self._depth += 1

    def on_end(self, _event: event.Event) -> None:
        """Add what it took."""
        self._depth -= 1
        if self._depth == 0:
            self.spent += time.monotonic() - self._since


class Door(CPUDispatcher):  # type: ignore[misc]
    """A kernel for Python, compiled on its first call; kernels that call it find its part instead.

    `py_func` is a function of a module (not within another function), `targetoptions` are those of ``numba.njit``, and
    ``_nrt``, whether references to arrays that it makes are counted.
    """

    def __init__(self, py_func: Callable[..., Any], *arguments: Any, **named: Any) -> None:
        super().__init__(py_func, *arguments, **named)
        self._cache = _Kept(py_func, "door", compiler.CompileResult._reduce, compiler.CompileResult._rebuild)

    @functools.cached_property
    def part(self) -> Any:
        """The same kernel, for kernels that call it."""
        options = {**self.targetoptions, "no_cpython_wrapper": True}
        part = _PartDispatcher(self.py_func, targetoptions=options, pipeline_class=_PartCompiler)
        part._cache = _Kept(self.py_func, "part", _pack_part, _unpack_part)
        return part

    @property
    def _numba_type_(self) -> Any:
        return Dispatcher(self.part)

    def compile(self, sig: Any) -> Any:
        """Compile the kernel for a signature, as numba does."""
        with _economical():
            return _with_room(super().compile, sig)


class _PartDispatcher(CPUDispatcher):  # type: ignore[misc]
    """A kernel for kernels. A literal number in the call does not make another specialisation, as it does in numba."""

    def get_call_template(self, args: Any, kws: Any) -> Any:
        return super().get_call_template(
            tuple(map(unliteral, args)), {name: unliteral(each) for name, each in kws.items()}
        )


def _part_decorator(template: Any) -> Any:
    """Return the decorator of what serves a builtin, such as ``np.zeros``: as for a part, without machine code."""
    return functools.partial(_jit_decorator(template), pipeline_class=_PartCompiler, no_cfunc_wrapper=True)


@contextmanager
def _economical() -> Iterator[None]:
    """Resolve each builtin operation once, and let the garbage collector walk less often through what is compiled."""
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
    """Return the signature of a call as numba does, which tries all of a dozen overloads for each ``x + y``.

    It is remembered by the types of the arguments, unless an overload serves: that depends on how it is compiled.
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


# Python keeps the frames of calls in pieces of 16 kB, and asks the system for one, and gives it back, each time a call
# crosses the end of a piece: with calls as deep as the compiler's a fifth of its time. A frame that wants more than
# that gets a large piece, in which all calls below it fit.
_with_room.__code__ = _with_room.__code__.replace(co_stacksize=1 << 17)


class _Part(JITCodeLibrary):  # type: ignore[misc]
    """A kernel in LLVM's language, with all it calls: for being linked into others, not for being run."""

    def finalize(self) -> None:
        self._raise_if_finalized()
        for library in dict.fromkeys(self._linking_libraries):
            self._reload_init.update(library._reload_init)
            self._final_module.link_in(library._get_module_for_linking(), preserve=True)
        self._finalize_dynamic_globals()
        for each in self._final_module.functions:
            if not each.is_declaration and each.linkage == llvm.Linkage.external:
                each.linkage = "linkonce_odr"  # several of what is linked together may hold it
        self._finalized = True

    def _get_module_for_linking(self) -> Any:
        self._ensure_finalized()
        return self._final_module


class _PartCompiler(compiler.Compiler):  # type: ignore[misc]
    """Numba's pipeline, ended before machine code is made."""

    def define_pipelines(self) -> list[Any]:
        self.state.library = _Part(self.state.targetctx.codegen(), self.state.func_id.func_qualname)
        self.state.flags.no_compile = True
        return [compiler.DefaultPassBuilder.define_nopython_pipeline(self.state)]

    def compile_extra(self, func: Callable[..., Any]) -> Any:
        made = super().compile_extra(func)._replace(entry_point=_name_of_its_own())
        self.state.targetctx.insert_user_function(made.entry_point, made.fndesc, [made.library])
        return made


def _name_of_its_own() -> Any:
    """Return the key by which numba finds a part: a function of the kind it expects, unique and never called."""
    return [].append


class _Kept:
    """The cache of one kernel, as numba uses it.

    Parameters
    ----------
    function : callable
        The kernel as written.
    kind : {"door", "part"}
        What it is compiled as.
    pack, unpack : callable
        Make something that can be pickled of what was compiled, and the reverse.
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
        """Return the compiled kernel for such types of arguments, None if there is none that can be used."""
        context.refresh()
        packed = cache.load(self._name, self._key(argument_types, context.codegen()))
        return None if packed is None else self._unpack(context, *pickle.loads(packed))

    def save_overload(self, argument_types: Any, made: Any) -> None:
        """Keep a compiled kernel; where that fails it is compiled again by the next process."""
        packed = serialize.dumps(self._pack(made))
        cache.save(self._name, self._key(argument_types, made.library.codegen), packed)


def _pack_part(made: Any) -> Any:
    made.fndesc.typemap = made.fndesc.calltypes = None  # needed no more, and not to be pickled
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
