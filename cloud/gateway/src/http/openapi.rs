//! OpenAPI document. What does the API look like to a program that has never seen it?
//!
//! Written by hand beside the routes, and held to them by the tests: every path here answers, and every route is here.

use std::f64::consts::TAU;

use axum::http::StatusCode;
use axum::response::Response;
use serde_json::{Value, json};

pub(super) async fn document() -> Response {
    super::json(StatusCode::OK, &openapi())
}

/// A reply by its schema's name.
fn reply(schema: &str, description: &str) -> Value {
    json!({
        "description": description,
        "content": { "application/json": { "schema": { "$ref": format!("#/components/schemas/{schema}") } } },
    })
}

/// An operation: what it does, its replies by status, and the errors that it may end with besides those that all share.
fn operation(id: &str, summary: &str, replies: &[(&str, &str, &str)], errors: &[(&str, &str)]) -> Value {
    let shared = [
        ("401", "The token is missing or wrong."),
        ("403", "Another origin, or another host."),
        ("404", "Nothing here: no such robot, goal or path."),
        ("429", "Too many requests a second."),
    ];
    let mut responses = serde_json::Map::new();
    for (status, schema, description) in replies {
        responses.insert((*status).to_owned(), reply(schema, description));
    }
    for (status, description) in shared.iter().chain(errors) {
        responses.insert((*status).to_owned(), reply("Error", description));
    }
    json!({ "operationId": id, "summary": summary, "responses": responses })
}

/// What asking a robot or its mission may end with.
const ASKED: &[(&str, &str)] = &[
    ("409", "Somebody else holds the lease."),
    ("422", "Understood and refused, with the reason."),
    ("502", "Whoever was asked failed."),
    ("503", "Too much to do, no leader, or no bus: try again."),
    ("504", "No answer in time."),
];

fn asked(id: &str, summary: &str, status: &str, schema: &str) -> Value {
    operation(id, summary, &[(status, schema, "Done.")], ASKED)
}

fn name_in_path(name: &str) -> Value {
    json!({
        "name": name, "in": "path", "required": true,
        "schema": { "type": "string", "pattern": "^[A-Za-z0-9_-]{1,64}$" },
    })
}

/// The document.
pub(super) fn openapi() -> Value {
    let (robot, goal) = (name_in_path("robot"), name_in_path("goal"));
    let mut submit = asked(
        "submitGoal",
        "Submit a goal. It is stored before it is answered; the same `id` again is the same goal.",
        "202",
        "GoalReply",
    );
    for (status, why) in [("400", "Not a goal."), ("413", "Too large."), ("415", "Not JSON.")] {
        submit["responses"][status] = reply("Error", why);
    }
    submit["requestBody"] = json!({
        "required": true,
        "content": { "application/json": { "schema": { "$ref": "#/components/schemas/Goal" } } },
    });
    let read = |id: &str, summary: &str, schema: &str| operation(id, summary, &[("200", schema, "Read.")], &[]);
    let mut stop_all = operation(
        "stopAll",
        "Stop every robot that shows.",
        &[("200", "Stops", "All stopped.")],
        &[],
    );
    stop_all["responses"]["504"] = reply("Stops", "Not every robot confirmed its stop.");
    let mut live = operation(
        "live",
        "WebSocket: the newest state of all robots, and of one in detail.",
        &[],
        &[
            ("400", "Not an upgrade."),
            ("426", "Not an upgrade."),
            ("503", "Too many browsers."),
        ],
    );
    live["responses"]["101"] = json!({ "description": "Switched to the WebSocket `zenav.v1`." });
    json!({
        "openapi": "3.1.0",
        "info": {
            "title": "zenav gateway", "version": env!("CARGO_PKG_VERSION"),
            "description": "Robots of a zenav deployment: state, maps, goals, stop. Metres, radians, seconds; map frame.",
            "license": { "name": "MIT OR Apache-2.0", "identifier": "MIT OR Apache-2.0" },
        },
        "servers": [{ "url": "/" }],
        "security": [{}, { "token": [] }],
        "paths": {
            "/api/v1/health": { "get": read("health", "Whether the gateway runs and reaches the bus.", "Health") },
            "/api/v1/openapi.json": { "get": read("openapi", "This document.", "Object") },
            "/api/v1/places": { "get": read("places", "Named places, map frame.", "Object") },
            "/api/v1/stop": { "post": stop_all },
            "/api/v1/robots": { "get": read("listRobots", "All robots with their latest state.", "Robots") },
            "/api/v1/robots/{robot}": {
                "parameters": [robot],
                "get": read("getRobot", "Everything known of a robot: each channel with its age in seconds.", "Object"),
            },
            "/api/v1/robots/{robot}/events": {
                "parameters": [robot],
                "get": read("listEvents", "The robot's latest events, oldest first.", "Events"),
            },
            "/api/v1/robots/{robot}/map": {
                "parameters": [robot],
                "get": asked("getMap", "The whole map: -1 unknown, 0 to 100 occupied in percent, row by row from the lowest.", "200", "Object"),
            },
            "/api/v1/robots/{robot}/stop": {
                "parameters": [robot],
                "post": asked("stop", "Stop the robot until it is resumed. Needs no lease and no cloud.", "200", "Stopped"),
            },
            "/api/v1/robots/{robot}/resume": {
                "parameters": [robot],
                "post": asked("resume", "Lift a stop: the robot takes a new plan from where it stands.", "200", "Stopped"),
            },
            "/api/v1/robots/{robot}/goals": {
                "parameters": [robot],
                "get": asked("listGoals", "Goals, newest first.", "200", "Goals"),
                "post": submit,
            },
            "/api/v1/robots/{robot}/goals/{goal}": {
                "parameters": [robot, goal],
                "get": asked("getGoal", "One goal.", "200", "Object"),
                "delete": asked("cancelGoal", "Cancel a goal.", "200", "GoalReply"),
            },
            "/api/v1/robots/{robot}/goals/{goal}/pause": {
                "parameters": [robot, goal],
                "post": asked("pauseGoal", "Pause a goal.", "200", "GoalReply"),
            },
            "/api/v1/robots/{robot}/goals/{goal}/resume": {
                "parameters": [robot, goal],
                "post": asked("resumeGoal", "Let a paused goal go on.", "200", "GoalReply"),
            },
            "/api/v1/live": { "get": live },
        },
        "components": {
            "securitySchemes": { "token": { "type": "http", "scheme": "bearer" } },
            "schemas": schemas(),
        },
    })
}

fn schemas() -> Value {
    let number = json!({ "type": "number" });
    let optional = |kind: &str| json!({ "type": [kind, "null"] });
    let point = json!({
        "type": "object", "required": ["x", "y"],
        "properties": { "x": number, "y": number, "yaw": optional("number") },
    });
    json!({
        "Object": { "type": "object" },
        "Error": {
            "type": "object", "required": ["error", "reason"],
            "properties": {
                "error": { "type": "string" }, "reason": { "type": "string" },
                "nearest_free": { "$ref": "#/components/schemas/Point" },
            },
        },
        "Point": point,
        "Health": {
            "type": "object", "required": ["version", "connected", "clients", "robots"],
            "properties": {
                "version": { "type": "string" }, "connected": { "type": "boolean" },
                "clients": { "type": "integer" }, "robots": { "type": "integer" },
            },
        },
        "Robots": {
            "type": "object", "required": ["robots"],
            "properties": { "robots": { "type": "array", "items": {
                "type": "object", "required": ["robot", "present"],
                "properties": {
                    "robot": { "type": "string" }, "present": { "type": "boolean" }, "age": optional("number"),
                    "mode": optional("string"), "link": optional("string"), "battery": optional("number"),
                    "guard": optional("string"), "pose": optional("object"), "parts": optional("array"),
                },
            } } },
        },
        "Events": {
            "type": "object", "required": ["events"],
            "properties": { "events": { "type": "array", "items": { "type": "object" } } },
        },
        "Goals": {
            "type": "object", "required": ["goals"],
            "properties": { "goals": { "type": "array", "items": { "type": "object" } } },
        },
        "Stopped": {
            "type": "object", "required": ["stopped"], "properties": { "stopped": { "type": "boolean" } },
        },
        "Stops": {
            "type": "object", "required": ["robots"],
            "properties": {
                "error": { "type": "string" }, "reason": { "type": "string" },
                "robots": { "type": "array", "items": {
                    "type": "object", "required": ["stopped"],
                    "properties": {
                        "robot": { "type": "string" }, "stopped": { "type": "boolean" }, "reason": { "type": "string" },
                    },
                } },
            },
        },
        "GoalReply": {
            "type": "object", "required": ["id", "state"],
            "properties": {
                "id": { "type": "string" }, "state": { "type": "string" }, "reason": { "type": "string" }, "robot": { "type": "string" },
            },
        },
        "Goal": {
            "type": "object", "additionalProperties": false,
            "description": "Exactly one of (x, y), place and waypoints; or a tree, alone or with one of them.",
            "properties": {
                "id": { "type": ["string", "null"], "pattern": "^[A-Za-z0-9_-]{1,64}$" },
                "x": optional("number"), "y": optional("number"),
                "yaw": { "type": ["number", "null"], "minimum": -TAU, "maximum": TAU },
                "place": optional("string"), "tree": optional("string"),
                "waypoints": { "type": "array", "maxItems": 1000, "items": { "$ref": "#/components/schemas/Point" } },
                "blackboard": { "type": "object" },
                "on_busy": { "enum": ["queue", "preempt", "reject"] },
                "priority": { "type": "integer", "minimum": -2147483648_i64, "maximum": 2147483647 },
                "deadline_secs": optional("number"), "tolerance": optional("number"),
                "profile": { "enum": ["fastest", "economy", null] },
            },
        },
    })
}
