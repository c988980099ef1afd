"""Requests to an ASGI application, without a network."""

from __future__ import annotations

import asyncio

import httpx


class Client:
    """`get`, `post`, `put` ... of an application; cookies are kept between requests."""

    def __init__(self, app, base):
        self.app, self.base, self.cookies = app, base, httpx.Cookies()

    def __getattr__(self, verb):
        return lambda path, **options: asyncio.run(self._ask(verb.upper(), path, options))

    async def _ask(self, verb, path, options):
        content = options.pop("content", None)
        if content is not None and not isinstance(content, bytes):
            content = _chunks(content)
        transport = httpx.ASGITransport(self.app, raise_app_exceptions=False)
        async with httpx.AsyncClient(transport=transport, base_url=self.base, cookies=self.cookies) as client:
            answer = await client.request(verb, path, content=content, **options)
            self.cookies.update(client.cookies)
        return answer


async def _chunks(parts):
    for part in parts:
        yield part
