#!/usr/bin/env python3
"""Does the action of a behaviour tree's RemoteAction node, from outside zenav.

    pip install eclipse-zenoh
    python3 cloud/mission/examples/remote_action.py kitchen/gripper tcp/127.0.0.1:7447

A tree then says what is to be done, here with the input `item` and the output `weight`:

    <RemoteAction name="Grab" server="kitchen/gripper" item="{item}" weight="{weight}"/>

The protocol: a query on the key carries JSON with `execution`, `action` (`run` or `cancel`), `robot`, `goal`,
`node`, `epoch` and `inputs`. The reply is JSON with `execution`, `status` (`RUNNING`, `SUCCESS` or `FAILURE`),
and perhaps `feedback` (text) and `outputs`. `run` comes again and again under the same execution until it is
answered with an end: only the first one begins anything. See `zenav_protocol::messages::RemoteRequest`.
"""

import json
import signal
import sys
import threading

import zenoh

# How long grabbing takes, s.
DURATION = 0.5


class Execution:
    """One grab: begun once, however often it is asked for."""

    def __init__(self, inputs):
        self.inputs = inputs
        self.status = "RUNNING"
        self.feedback = "closes the gripper"
        self.outputs = {}
        self._stop = threading.Event()
        threading.Thread(target=self._work, daemon=True).start()

    def cancel(self):
        self._stop.set()

    def _work(self):
        if self._stop.wait(DURATION):
            self.feedback, self.status = "stopped", "FAILURE"
            return
        item = self.inputs.get("item")
        if not isinstance(item, str):
            self.feedback, self.status = "`item`: expected text", "FAILURE"
            return
        self.outputs = {"weight": len(item)}
        self.feedback = f"holds the {item}"
        # Last, since another thread reads what it guards.
        self.status = "SUCCESS"


class Gripper:
    """Answers queries. A program that must not do an action twice keeps the ids on disk as well."""

    def __init__(self):
        self._executions = {}
        self._lock = threading.Lock()

    def answer(self, query):
        try:
            request = json.loads(query.payload.to_bytes())
            reply = self._reply(request)
        except (AttributeError, KeyError, TypeError, ValueError) as error:
            refusal = {"error": "BadRequest", "reason": str(error)}
            query.reply_err(json.dumps(refusal), encoding=zenoh.Encoding.APPLICATION_JSON)
            return
        query.reply(query.key_expr, json.dumps(reply), encoding=zenoh.Encoding.APPLICATION_JSON)

    def _reply(self, request):
        name, cancels = request["execution"], request["action"] == "cancel"
        with self._lock:
            execution = self._executions.get(name)
            if execution is None and not cancels:
                print(f"begins {name}: {request['inputs']}", file=sys.stderr, flush=True)
                execution = self._executions[name] = Execution(request["inputs"])
        if execution is None:
            return {"execution": name, "status": "FAILURE", "feedback": "never begun"}
        if cancels:
            execution.cancel()
        status = execution.status
        return {
            "execution": name,
            "status": status,
            "feedback": execution.feedback,
            "outputs": execution.outputs if status == "SUCCESS" else {},
        }


def main():
    if len(sys.argv) != 3:
        sys.exit(f"usage: {sys.argv[0]} KEY ENDPOINT")
    key, endpoint = sys.argv[1:]
    config = zenoh.Config()
    config.insert_json5("mode", '"client"')
    config.insert_json5("connect/endpoints", json.dumps([endpoint]))
    gripper = Gripper()
    with zenoh.open(config) as session:
        session.declare_queryable(key, gripper.answer)
        print(f"serves {key}", file=sys.stderr, flush=True)
        signal.sigwait({signal.SIGINT, signal.SIGTERM})


if __name__ == "__main__":
    signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT, signal.SIGTERM})
    main()
