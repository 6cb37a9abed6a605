# SPDX-License-Identifier: MIT
"""Names from a robot description, made safe for C, CMake, Python and paths.

A robot's name becomes an identifier by this rule:

1. Accents are dropped. A run of other characters outside [A-Za-z0-9] becomes one "_", and none stays at the ends. An
   empty name becomes "robot".
2. The prefix "robot_" is put before a leading digit, before "stiffgen", and before reserved names: words of C, C++,
   Python, CMake and Windows (device names), Python modules and C headers that the name would hide, and global names
   that a C++ namespace meets in every program (functions of the C library, std, Eigen), and those that would make a
   public function equal to an internal one.
3. A name is cut to 40 characters.

The rule does not change its own results. Joint and link names never become identifiers; they stand in string literals
and comments, escaped by the functions below.
"""

from __future__ import annotations

import keyword
import re
import unicodedata

from stiffgen.core.errors import StiffgenError, printable

MAX_LENGTH = 40

_C_AND_CPP = """
    alignas alignof and and_eq asm auto bitand bitor bool break case catch char char8_t char16_t char32_t class
    compl concept const consteval constexpr constinit const_cast continue co_await co_return co_yield decltype
    default delete do double dynamic_cast else enum explicit export extern false float for friend goto if inline
    int long mutable namespace new noexcept not not_eq nullptr operator or or_eq private protected public register
    reinterpret_cast requires restrict return short signed sizeof static static_assert static_cast struct switch
    template this thread_local throw true try typedef typeid typename union unsigned using virtual void volatile
    wchar_t while xor xor_eq main stdin stdout stderr linux unix test all install
    con prn aux nul com1 com2 com3 com4 com5 com6 com7 com8 com9 lpt1 lpt2 lpt3 lpt4 lpt5 lpt6 lpt7 lpt8 lpt9
"""
# A folder NAME on Python's path hides a module of that name; NAME.h in an include folder hides a header. Lists of our
# own, since Python's differs from version to version, and a robot's name must not.
_HEADERS = """
    assert complex ctype errno fenv float inttypes iso646 limits locale math setjmp signal stdalign stdarg
    stdatomic stdbit stdbool stdckdint stddef stdint stdio stdlib stdnoreturn string tgmath threads time uchar
    wchar wctype unistd pthread fcntl poll sched semaphore dirent dlfcn glob grp pwd netdb regex spawn strings
    syslog termios utime features endian memory malloc alloca values sysexits windows process direct python
    structmember pyconfig
"""
_MODULES = """
    abc aifc annotationlib antigravity argparse array ast asynchat asyncio asyncore atexit audioop base64 bdb
    binascii binhex bisect builtins bz2 calendar cgi cgitb chunk cmath cmd code codecs codeop collections colorsys
    compileall compression concurrent configparser contextlib contextvars copy copyreg cprofile crypt csv ctypes
    curses dataclasses datetime dbm decimal difflib dis distutils doctest email encodings ensurepip enum errno
    faulthandler fcntl filecmp fileinput fnmatch formatter fractions ftplib functools gc genericpath getopt
    getpass gettext glob graphlib grp gzip hashlib heapq hmac html http idlelib imaplib imghdr imp importlib
    inspect io ipaddress itertools json keyword lib2to3 linecache locale logging lzma macpath mailbox mailcap
    marshal math mimetypes mmap modulefinder msilib msvcrt multiprocessing netrc nis nntplib nt ntpath nturl2path
    numbers opcode operator optparse os ossaudiodev parser pathlib pdb pickle pickletools pipes pkgutil platform
    plistlib poplib posix posixpath pprint profile pstats pty pwd py_compile pyclbr pydoc pydoc_data pyexpat queue
    quopri random re readline reprlib resource rlcompleter runpy sched secrets select selectors shelve shlex
    shutil signal site smtpd smtplib sndhdr socket socketserver spwd sqlite3 sre_compile sre_constants sre_parse
    ssl stat statistics string stringprep struct subprocess sunau symbol symtable sys sysconfig syslog tabnanny
    tarfile telnetlib tempfile termios textwrap this threading time timeit tkinter token tokenize tomllib trace
    traceback tracemalloc tty turtle turtledemo types typing unicodedata unittest urllib uu uuid venv warnings
    wave weakref webbrowser winreg winsound wsgiref xdrlib xml xmlrpc zipapp zipfile zipimport zlib zoneinfo
    numpy scipy matplotlib casadi sympy mpmath jinja2 dask distributed xarray pandas pytest mujoco pinocchio
    setuptools pip
"""
# NAME.hpp's namespace NAME stands beside the global functions of C libraries.
_GLOBALS = """
    std eigen posix abs div exit free read write open close link unlink pipe dup fork exec index rindex remove rename
    system access sleep nice getenv putenv gamma lgamma j0 j1 jn y0 y1 yn sin cos tan exp log pow sqrt floor ceil round
    printf scanf puts gets send recv bind listen accept connect socket kill wait pause alarm brk sbrk swab sync acct
"""
CPP_NAMES = ("detail", "map", "assign", "row_major", "self_check", "Array", "Input", "Output", "Matrix", "Impedance")
"""Names in the namespace of NAME.hpp other than functions; tips and potentials must not have these names."""
_HIDDEN = frozenset((_HEADERS + _MODULES).split())
_PYTHON = {word.lower() for word in (*keyword.kwlist, *keyword.softkwlist)}
_INTERNAL = "add brake_fast compute_reference mirror multiply pack smooth"
"""Names of robots that would give an internal function and a public name the same text: mirror_lower is one."""
_RESERVED = _HIDDEN | frozenset((_C_AND_CPP + _GLOBALS).split()) | frozenset(_INTERNAL.split()) | _PYTHON


def identifier(name: str) -> str:
    """Return the identifier that stands for a robot's name (rule in the module's docstring)."""
    plain = unicodedata.normalize("NFKD", name[:1000]).encode("ascii", "ignore").decode()
    made = re.sub(r"[^A-Za-z0-9]+", "_", plain).strip("_") or "robot"
    made = made[:MAX_LENGTH].rstrip("_")
    if made[0].isdigit() or made.lower() in _RESERVED or made.lower().startswith("stiffgen"):
        made = f"robot_{made}"[:MAX_LENGTH].rstrip("_")
    return made


def checked_identifier(name: str) -> str:
    """Return a name that the user chose, which must already follow the rule.

    Raises:
        StiffgenError: it does not; the message has the nearest name that does.

    """
    if identifier(name) != name:
        raise StiffgenError(
            f"--name '{printable(name)}' is no usable name for a C library and a Python module"
            f"{', which would hide another of that name' if name.lower() in _HIDDEN else ''}; "
            f"nearest: --name {identifier(name)}"
        )
    return name


def c_string(text: str) -> str:
    """Return a C string literal; everything but plain ASCII as octal escapes of its UTF-8 bytes."""
    plain = set(range(0x20, 0x7F)) - {ord(c) for c in '"\\?'}
    return '"' + "".join(chr(b) if b in plain else f"\\{b:03o}" for b in text.encode("utf-8", "replace")) + '"'


def comment(text: str, most: int = 80) -> str:
    """Return text for a C or CMake comment, Markdown or a docstring: printable ASCII without markup, cut at its end."""
    plain = "".join(c if " " <= c <= "~" and c not in '*\\`<>|"?#@$[]' else "_" for c in text)
    return plain[:most] or "_"


def c_comment(text: str) -> str:
    """Return a line with names from a file, safe for a C comment: no end of comment, no line splice."""
    return "".join(c if " " <= c <= "~" and c not in "*\\?" else "_" for c in text)
