"""The service: API, operator page, daemon.

`run_daemon` of ``daemon`` is the composition root and what outsiders use. The package itself imports nothing: the demo
uses grading and report, which need no web server.
"""
