"""Gate of the live view: it lets in its own page only, and from it only what the panel offers.

Any page that a browser has open may send requests to this machine, and any program of this machine too. viser itself
takes every one, sets whatever a message names, and opens a tunnel to the public where a client asks for it.
"""

import contextlib
import math
from collections.abc import Awaitable, Callable, Iterator, Mapping
from functools import partial
from http import HTTPStatus
from typing import Any

LOOPBACK = ("127.0.0.1", "localhost")
"""Names by which a browser may ask for the page, at any port: it may be forwarded, as by ssh -L. Another name is that
of a foreign page which lets its own name lead here."""
MAX_MESSAGE_BYTES = 65536
CAMERA = {
    **dict.fromkeys(("position", "look_at", "up_direction"), 3),
    **dict.fromkeys(("fov", "near", "far", "image_height", "image_width"), 0),
    "wxyz": 4,
}
"""Fields of a message about a visitor's camera, and their lengths; 0 for a number alone."""
Offers = Mapping[str, Callable[[Any], bool]]
"""Check of a control's value by the control's uuid."""


@contextlib.contextmanager
def guarded(offers: Offers) -> Iterator[None]:
    """Guard the websocket servers that are started meanwhile: viser starts one, and has no option for any of this."""
    import websockets.asyncio.server as library

    serve = library.serve
    library.serve = partial(_serve, serve, offers)
    try:
        yield
    finally:
        library.serve = serve


def _serve(
    serve: Callable[..., Any],
    offers: Offers,
    handler: Callable[[Any], Awaitable[None]],
    *arguments: Any,
    process_request: Callable[[Any, Any], Any],
    **options: Any,
) -> Any:
    """Serve with checks before the handlers of connections and requests."""

    async def handle(connection: Any) -> None:
        connection.recv = _filtered(connection.recv, offers)
        await handler(connection)

    def answer(connection: Any, request: Any) -> Any:
        if not is_own(request.headers.get_all("Host"), request.headers.get_all("Origin")):
            return connection.respond(HTTPStatus.FORBIDDEN, "foveate: only its own page may ask\n")
        return process_request(connection, request)

    return serve(handle, *arguments, process_request=answer, **{**options, "max_size": MAX_MESSAGE_BYTES})


def is_own(hosts: list[str], origins: list[str]) -> bool:
    """True for a request to this machine by its own name, and from no page of another origin."""
    if len(hosts) != 1 or hosts[0].rpartition(":")[0] not in LOOPBACK:
        return False
    return all(origin == f"http://{hosts[0]}" for origin in origins)


def _filtered(receive: Callable[[], Awaitable[Any]], offers: Offers) -> Callable[[], Awaitable[Any]]:
    async def recv() -> Any:
        while not is_offered(raw := await receive(), offers):
            pass
        return raw

    return recv


def is_offered(raw: bytes | str, offers: Offers) -> bool:
    """True for the message of a control whose value is one of those offered, and of a camera."""
    import msgspec

    try:
        message = msgspec.msgpack.decode(raw) if isinstance(raw, bytes) else None
    except (ValueError, TypeError, RecursionError):
        return False
    if not isinstance(message, dict):
        return False
    kind, fields = message.get("type"), {name: part for name, part in message.items() if name != "type"}
    if kind == "ViewerCameraMessage":
        return set(fields) == set(CAMERA) and all(_is_finite(fields[name], size) for name, size in CAMERA.items())
    uuid, updates = fields.get("uuid"), fields.get("updates")
    if kind != "GuiUpdateMessage" or set(fields) != {"uuid", "updates"} or not isinstance(uuid, str):
        return False
    if not isinstance(updates, dict) or set(updates) != {"value"}:
        return False
    return uuid in offers and offers[uuid](updates["value"])


def _is_finite(part: Any, size: int) -> bool:
    """True for a finite number, or a list of `size` of them."""
    numbers = part if size else [part]
    if not isinstance(numbers, list) or len(numbers) != (size or 1):
        return False
    return all(type(x) in (int, float) and math.isfinite(x) for x in numbers)
