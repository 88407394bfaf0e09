"""A camera that is read by a thread of its own, so that no frame from before the arm stood still is ever used.

A driver's queue hands out its oldest frame first. The thread takes every frame as it comes and only looks at its time
stamp; the picture itself is fetched, which may be expensive, for the one frame that somebody waits for.
"""

from __future__ import annotations

import asyncio
import contextlib
import threading
from dataclasses import asdict, dataclass, field
from typing import TYPE_CHECKING, Any, Final, Protocol

from srvs_cell.alarms import Alarm
from srvs_cell.ports import Frame, FrameError, Lifecycle, NotConnectedError, NotReadyError, PortError

if TYPE_CHECKING:
    from collections.abc import Callable

    import numpy as np
    from numpy.typing import NDArray

    from srvs_cell.ports import Clock

_FAILED_GRABS: Final = 3
"""So many failures in a row end the stream: an unplugged camera fails at once and for ever."""

_RETRY_S: Final = 0.05
_FIRST_PICTURES: Final = 3
"""So many pictures of a stream that begins are looked at: a camera that compresses may begin with torn ones."""

_OPEN_TIMEOUT_S: Final = 10.0
"""Real seconds: a device that hangs in opening must not let a clear hang."""


@dataclass(frozen=True)
class FrameStamp:
    """When a frame was exposed.

    Attributes:
        stamp_s: start of exposure on the process's `Clock`.
        sequence: counts frames of the stream, gaps where frames were dropped.
    """

    stamp_s: float
    sequence: int


@dataclass
class CameraCounters:
    """What has happened to a camera's stream since this process began.

    Attributes:
        frames: buffers that the device has handed out.
        too_old: of these, frames that somebody could not use because they were exposed before he asked.
        misdated: buffers that were dropped because their time stamp is impossible.
        failed_grabs: waits that ended without a buffer.
        invalid: pictures that could not be decoded or had the wrong size.
        timeouts: requests that got no frame in time, for whatever reason.
        streams_lost: streams that have ended by themselves.
    """

    frames: int = 0
    too_old: int = 0
    misdated: int = 0
    failed_grabs: int = 0
    invalid: int = 0
    timeouts: int = 0
    streams_lost: int = 0


class Capture(Protocol):
    """An open stream, used by one thread at a time. Any call may raise `PortError`."""

    def grab(self) -> FrameStamp | None:
        """Wait, for some seconds at most, for the next frame; None where none came.

        Raises:
            FrameError: the frame's time stamp is impossible; the next one may be right.
        """
        ...

    def retrieve(self) -> NDArray[np.uint8]:
        """Return the picture of the frame grabbed last."""
        ...

    def close(self) -> None:
        """Let go of the device; called when no other call is under way."""
        ...


@dataclass(eq=False)
class _Wanted:
    """Somebody's request for a frame; `seen` counts the frames that were too old for it."""

    not_before_s: float
    loop: asyncio.AbstractEventLoop
    answer: asyncio.Future[Frame]
    seen: int = 0
    newest_s: float = field(default=float("-inf"))

    def resolve(self, result: Frame | PortError) -> None:
        with contextlib.suppress(RuntimeError):  # the loop has closed: nobody waits any more
            self.loop.call_soon_threadsafe(self._set, result)

    def _set(self, result: Frame | PortError) -> None:
        if self.answer.done():
            return
        if isinstance(result, Frame):
            self.answer.set_result(result)
        else:
            self.answer.set_exception(result)


class GrabbingCamera:
    """Camera on a `Capture`.

    Args:
        open_capture: opens the device; raises `PortError` (CAMERA_UNAVAILABLE, CAMERA_SETTING) with the reason.
        clock: the process's clock.
        name: what people call the camera.
        size_px: (width, height) that pictures must have; None to take what comes.
        first_frame_timeout_s: how long a stream may take to begin; None where that is not waited for.
        open_timeout_s: real seconds that opening the device may take.
    """

    def __init__(
        self,
        open_capture: Callable[[], Capture],
        clock: Clock,
        name: str,
        size_px: tuple[int, int] | None = None,
        first_frame_timeout_s: float | None = None,
        open_timeout_s: float = _OPEN_TIMEOUT_S,
    ) -> None:
        self._open_capture, self._clock, self._name, self._size_px = open_capture, clock, name, size_px
        self._first_frame_timeout_s, self._open_timeout_s = first_frame_timeout_s, open_timeout_s
        self._counters = CameraCounters()
        self._lifecycle = Lifecycle.DISCONNECTED
        self._capture: Capture | None = None
        self._thread: threading.Thread | None = None
        self._stopping = threading.Event()
        self._lock = threading.Lock()
        self._wanted: list[_Wanted] = []
        self._lost: PortError | None = None

    @property
    def lifecycle(self) -> Lifecycle:
        """Where the camera is in its life."""
        return Lifecycle.DISCONNECTED if self._lost is not None else self._lifecycle

    @property
    def description(self) -> str:
        """What stands behind the port, for people."""
        return self._name

    @property
    def counters(self) -> dict[str, int]:
        """What has happened to the stream since this process began, by name."""
        return asdict(self._counters)

    async def connect(self) -> None:
        """Open the device and check its settings. Raises `PortError` with the reason."""
        if self._lost is not None:
            await self.disconnect()
        if self._lifecycle == Lifecycle.DISCONNECTED:
            self._capture = await self._opened()
            self._lifecycle = Lifecycle.INACTIVE

    async def activate(self) -> None:
        """Start to read frames.

        Raises:
            FrameError: CAMERA_TIMEOUT where the stream does not begin, IMAGE_INVALID where its pictures are wrong.
            NotConnectedError: CAMERA_UNAVAILABLE where it ends at once.
        """
        capture = self._connected()
        if self._lifecycle == Lifecycle.INACTIVE:
            await self._end_thread()  # one that a stream which did not begin has left behind
            self._stopping.clear()
            self._thread = threading.Thread(target=self._read, args=(capture,), name=self._name, daemon=True)
            self._thread.start()
            self._lifecycle = Lifecycle.ACTIVE
            if self._first_frame_timeout_s is not None:
                try:
                    await self._first_picture(self._first_frame_timeout_s)
                except BaseException:
                    self._stopping.set()  # who asked is told at once; the device may hold the thread for a while
                    self._lifecycle = Lifecycle.INACTIVE
                    raise

    async def deactivate(self) -> None:
        """Stop to read frames."""
        await self._end_thread()
        if self._lifecycle == Lifecycle.ACTIVE:
            self._lifecycle = Lifecycle.INACTIVE

    async def disconnect(self) -> None:
        """Close the device."""
        capture, self._capture = self._capture, None
        await self._end_thread()
        if capture is not None:
            await asyncio.to_thread(capture.close)
        self._lost = None
        self._lifecycle = Lifecycle.DISCONNECTED

    async def grab(self, not_before_s: float, timeout_s: float) -> Frame:
        """Return the first frame whose exposure began at or after ``not_before_s``.

        Raises:
            FrameError: CAMERA_TIMEOUT where no frame came in time, CAMERA_STALE where only older ones came,
                IMAGE_INVALID where the frame has the wrong size.
            NotConnectedError: CAMERA_UNAVAILABLE where the stream has ended.
            NotReadyError: the camera is not active.
        """
        self._connected()
        if self._lifecycle != Lifecycle.ACTIVE:
            raise NotReadyError(Alarm.CAMERA_UNAVAILABLE, f"{self._name} is {self._lifecycle.value}, not active.")
        loop = asyncio.get_running_loop()
        wanted = _Wanted(not_before_s, loop, loop.create_future())
        with self._lock:
            self._wanted.append(wanted)
        timer = asyncio.ensure_future(self._clock.sleep(timeout_s))
        either: set[asyncio.Future[Any]] = {wanted.answer, timer}
        try:
            await asyncio.wait(either, return_when=asyncio.FIRST_COMPLETED)
            if not wanted.answer.done():
                await timer  # a clock that has stopped says so here
                self._counters.timeouts += 1
                raise self._too_late(wanted, timeout_s)
            return wanted.answer.result()
        finally:
            timer.cancel()
            wanted.answer.cancel()
            with self._lock, contextlib.suppress(ValueError):  # the thread may just have taken it
                self._wanted.remove(wanted)

    def _too_late(self, wanted: _Wanted, timeout_s: float) -> FrameError:
        if wanted.seen:
            return FrameError(
                Alarm.CAMERA_STALE,
                f"{self._name}: {wanted.seen} frames in {timeout_s} s, the newest was exposed "
                f"{wanted.not_before_s - wanted.newest_s:.3f} s too early.",
            )
        return FrameError(Alarm.CAMERA_TIMEOUT, f"{self._name}: no frame within {timeout_s} s.")

    def _connected(self) -> Capture:
        if self._lost is not None:
            raise NotConnectedError(self._lost.alarm, self._lost.detail)
        if self._capture is None:
            raise NotConnectedError(Alarm.CAMERA_UNAVAILABLE, f"{self._name} is not connected.")
        return self._capture

    async def _first_picture(self, timeout_s: float) -> None:
        """Wait for the stream to begin; its first pictures may be torn."""
        for left in reversed(range(_FIRST_PICTURES)):
            try:
                await self.grab(float("-inf"), timeout_s)
            except FrameError as error:
                if error.alarm is not Alarm.IMAGE_INVALID or not left:
                    raise
            else:
                return

    async def _opened(self) -> Capture:
        """Open the device within its time; one that comes to be open later is closed again."""
        opening = asyncio.ensure_future(asyncio.to_thread(self._open_capture))
        try:
            done, _ = await asyncio.wait({opening}, timeout=self._open_timeout_s)
        finally:
            if not opening.done():
                opening.add_done_callback(_close_late)
        if not done:
            raise NotConnectedError(
                Alarm.CAMERA_UNAVAILABLE,
                f"{self._name}: opening has taken longer than {self._open_timeout_s} s: plug the camera in again.",
            )
        return opening.result()

    async def _end_thread(self) -> None:
        self._stopping.set()
        thread, self._thread = self._thread, None
        if thread is not None:
            await asyncio.to_thread(thread.join)

    def _read(self, capture: Capture) -> None:
        """Take every frame as it comes; the body of the thread."""
        failed = 0
        while not self._stopping.is_set():
            try:
                failure = self._take(capture)
            except PortError as error:
                self._lose(error)
                return
            failed = 0 if failure is None else failed + 1
            if failure is not None and failed == _FAILED_GRABS:
                self._lose(failure)
                return
            if failed:
                self._stopping.wait(_RETRY_S)

    def _take(self, capture: Capture) -> PortError | None:
        """Take one frame; return what the stream has ended with, should this failure go on."""
        try:
            stamp = capture.grab()
        except FrameError as error:
            self._counters.misdated += 1
            return error
        if stamp is None:
            self._counters.failed_grabs += 1
            return NotConnectedError(
                Alarm.CAMERA_UNAVAILABLE,
                f"{self._name}: the stream has ended, {_FAILED_GRABS} reads in a row failed.",
            )
        self._offer(capture, stamp)
        return None

    def _offer(self, capture: Capture, stamp: FrameStamp) -> None:
        """Give the frame to those who wait for one as new as this; the picture is fetched only for them."""
        self._counters.frames += 1
        with self._lock:
            served = [wanted for wanted in self._wanted if stamp.stamp_s >= wanted.not_before_s]
            self._wanted = [wanted for wanted in self._wanted if wanted not in served]
            self._counters.too_old += bool(self._wanted)
            for wanted in self._wanted:
                wanted.seen, wanted.newest_s = wanted.seen + 1, stamp.stamp_s
        if served:
            result = self._picture(capture, stamp)
            for wanted in served:
                wanted.resolve(result)

    def _picture(self, capture: Capture, stamp: FrameStamp) -> Frame | PortError:
        try:
            image = capture.retrieve()
        except FrameError as error:  # one bad frame does not end the stream
            self._counters.invalid += 1
            return error
        size_px = (image.shape[1], image.shape[0])
        if self._size_px is not None and size_px != self._size_px:
            self._counters.invalid += 1
            return FrameError(
                Alarm.IMAGE_INVALID, f"{self._name}: the picture has {size_px} pixels, the config says {self._size_px}."
            )
        return Frame(image, stamp.stamp_s, stamp.sequence)

    def _lose(self, error: PortError) -> None:
        self._counters.streams_lost += 1
        self._lost = error
        with self._lock:
            waiting, self._wanted = self._wanted, []
        for wanted in waiting:
            wanted.resolve(NotConnectedError(error.alarm, error.detail))


def _close_late(opening: asyncio.Future[Capture]) -> None:
    """Let go of a device that was opened after nobody waited for it any more."""
    if not opening.cancelled() and opening.exception() is None:
        opening.result().close()
