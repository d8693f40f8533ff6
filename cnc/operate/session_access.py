"""Access to an operator session, in this process or in one of its own.

:class:`cnc.operate.operator_session.OperatorSession` operates the machine in the process that makes
it. :class:`cnc.operate.remote_session.RemoteSession` lets a process of its own do so.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from concurrent.futures import Future
from typing import TYPE_CHECKING, Any, Concatenate, NamedTuple, ParamSpec, Protocol, TypeVar

from cnc.machine.models import Machine
from cnc.operate.events import Event, Listener, State
from cnc.operate.worker import KEEP_ALIVE

if TYPE_CHECKING:
    from cnc.operate.operator_session import OperatorSession

P = ParamSpec("P")
T = TypeVar("T")
Offsets = dict[str, dict[str, float]]


class JogBegun(NamedTuple):
    """A jog that lasts until its release.

    Attributes:
        id: Its number.
        feed: Its speed, mm/s, which may be less than was asked for.
    """

    id: int
    feed: float


class SessionAccess(Protocol):
    """What the users of a session need, wherever it is.

    All properties are the last known ones. They cost the session nothing.
    """

    machine: Machine
    history: list[str]

    @property
    def state(self) -> State:
        """The state."""

    @property
    def dialog(self) -> Event | None:
        """The open question to the operator."""

    @property
    def offsets(self) -> Offsets:
        """Offsets by name and axis, mm; empty without a board."""

    @property
    def limited_machine(self) -> Machine:
        """The machine with the travel of the board, and the kind of the board."""

    def listen(self, listener: Listener) -> Callable[[], None]:
        """Call ``listener`` with each event; the result ends this."""

    def ask(
        self,
        method: Callable[Concatenate[OperatorSession, P], T],
        *args: P.args,
        **kwargs: P.kwargs,
    ) -> Future[T]:
        """Call a method of the session.

        Returns:
            What the method returns or raises. An activity returns a future of its own.
        """

    def close(self) -> None:
        """Come to rest, release the board, and end the session."""


def begin_jog(
    session: OperatorSession,
    directions: Mapping[str, float],
    feed: float | None = None,
    *,
    unhomed: bool = False,
    keep_alive: float = KEEP_ALIVE,
) -> JogBegun:
    """Begin a jog as :meth:`OperatorSession.jog`; ``keep_jog`` and ``release_jog`` end it."""
    jog = session.jog(directions, feed, unhomed=unhomed, keep_alive=keep_alive)
    return JogBegun(jog.id, jog.feed)


def answered(action: Callable[[], Any]) -> Future[Any]:
    """Return the result of an action as a future."""
    future: Future[Any] = Future()
    future.set_running_or_notify_cancel()
    try:
        found = action()
    except Exception as error:
        future.set_exception(error)
    else:
        future.set_result(found)
    return future
