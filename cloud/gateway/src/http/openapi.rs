//! OpenAPI document. How is the API described to unknown programs?
//!
//! Written by hand beside the routes, and compared with them by tests: every path here answers, and every route is here.

use std::f64::consts::TAU;

use axum::http::StatusCode;
use axum::response::Response;
use serde_json::{Value, json};

pub(super) async fn document() -> Response {
    super::json(StatusCode::OK, &openapi())
}

/// A reply with the named schema.
fn reply(schema: &str, description: &str) -> Value {
    json!({
        "description": description,
        "content": { "application/json": { "schema": { "$ref": format!("#/components/schemas/{schema}") } } },
    })
}

/// An operation: its summary, its replies by status, and its errors besides the common ones.
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

/// Errors of requests to a robot or its mission.
const ASKED: &[(&str, &str)] = &[
    ("409", "Somebody else holds the lease."),
    ("422", "Understood and refused, with the reason."),
    ("502", "Whoever was asked failed."),
    ("503", "Too much to do, no leader, or no bus: try again."),
    ("504", "No answer in time."),
];

fn asked(id: &str, summary: &str, schema: &str) -> Value {
    operation(id, summary, &[("200", schema, "Done.")], ASKED)
}

/// The operation with a request body of the named schema, and the errors of invalid bodies.
fn taking(schema: &str, mut operation: Value) -> Value {
    for (status, why) in [
        ("400", "Not what is expected."),
        ("413", "Too large."),
        ("415", "Not JSON."),
    ] {
        operation["responses"][status] = reply("Error", why);
    }
    operation["requestBody"] = json!({
        "required": true,
        "content": { "application/json": { "schema": { "$ref": format!("#/components/schemas/{schema}") } } },
    });
    operation
}

/// The OpenAPI document.
pub(super) fn openapi() -> Value {
    json!({
        "openapi": "3.1.0",
        "info": {
            "title": "zenav gateway", "version": env!("CARGO_PKG_VERSION"),
            "description": "Robots of a zenav deployment: state, maps, goals, stop. Metres, radians, seconds; map frame.",
            "license": { "name": "MIT OR Apache-2.0", "identifier": "MIT OR Apache-2.0" },
        },
        "servers": [{ "url": "/" }],
        "security": [{}, { "token": [] }],
        "paths": joined([fleet_paths(), robot_paths(), annotation_paths(), goal_paths()]),
        "components": {
            "securitySchemes": { "token": { "type": "http", "scheme": "bearer" } },
            "schemas": joined([shape_schemas(), request_schemas(), fleet_schemas(), robot_schemas()]),
        },
    })
}

/// One object with the entries of several.
fn joined<const N: usize>(objects: [Value; N]) -> Value {
    let entries = objects.into_iter().filter_map(|object| match object {
        Value::Object(entries) => Some(entries),
        _ => None,
    });
    Value::Object(entries.flatten().collect())
}

/// A parameter in the path.
fn in_path(name: &str, schema: &Value) -> Value {
    json!({ "name": name, "in": "path", "required": true, "schema": schema })
}

/// An identity: part of a key.
fn id() -> Value {
    json!({ "type": "string", "pattern": "^[A-Za-z0-9_-]{1,64}$" })
}

fn read(id: &str, summary: &str, schema: &str) -> Value {
    operation(id, summary, &[("200", schema, "Read.")], &[])
}

/// Paths of the gateway and of all robots.
fn fleet_paths() -> Value {
    let unreached = "No robot is known, or the router is out of reach: all that are known are stopped.";
    let stops = [
        ("200", "Stops", "All stopped."),
        ("503", "Stops", unreached),
        ("504", "Stops", "Not every robot confirmed its stop."),
    ];
    let not_upgraded = [
        ("400", "Not an upgrade."),
        ("426", "Not an upgrade."),
        ("503", "Too many browsers."),
    ];
    let what = "WebSocket: the newest state of all robots, and of one in detail.";
    let mut live = operation("live", what, &[], &not_upgraded);
    live["responses"]["101"] = json!({ "description": "Switched to the WebSocket `zenav.v1`." });
    json!({
        "/api/v1/health": { "get": read("health", "Whether the gateway runs and reaches the bus.", "Health") },
        "/api/v1/openapi.json": { "get": read("openapi", "This document.", "Object") },
        "/api/v1/places": { "get": read("places", "Named places, map frame.", "Object") },
        "/api/v1/stop": { "post": operation("stopAll", "Stop every robot that shows.", &stops, &[]) },
        "/api/v1/robots": { "get": read("listRobots", "All robots with their latest state.", "Robots") },
        "/api/v1/live": { "get": live },
    })
}

/// Paths of one robot.
fn robot_paths() -> Value {
    let robot = in_path("robot", &id());
    json!({
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
            "get": asked("getMap", "The whole map: -1 unknown, 0 to 100 occupied in percent, row by row from the lowest.", "Object"),
        },
        "/api/v1/robots/{robot}/stop": {
            "parameters": [robot],
            "post": asked("stop", "Stop the robot until it is resumed. Needs no lease and no cloud.", "Stopped"),
        },
        "/api/v1/robots/{robot}/resume": {
            "parameters": [robot],
            "post": asked("resume", "Lift a stop: the robot takes a new plan from where it stands.", "Stopped"),
        },
        "/api/v1/robots/{robot}/pose": {
            "parameters": [robot],
            "post": taking("Pose", asked("setPose", "Tell the robot where it is, to within some decimetres: it drops its plan, and goes on from there.", "Localisation")),
        },
    })
}

/// Paths of the places and zones of a robot's map.
fn annotation_paths() -> Value {
    let name = json!({ "type": "string", "minLength": 1, "maxLength": 64 });
    let (robot, place, zone) = (in_path("robot", &id()), in_path("place", &name), in_path("zone", &name));
    let removal = |id: &str, summary: &str| {
        let mut removal = asked(id, summary, "Annotations");
        removal["responses"]["400"] = reply("Error", "Not a name.");
        removal
    };
    json!({
        "/api/v1/robots/{robot}/places": {
            "parameters": [robot],
            "get": asked("listPlaces", "Named places of the robot's map.", "Places"),
        },
        "/api/v1/robots/{robot}/places/{place}": {
            "parameters": [robot, place],
            "put": taking("Place", asked("putPlace", "Add a place, or move the one of this name.", "Annotations")),
            "delete": removal("deletePlace", "Remove a place, also one of the world."),
        },
        "/api/v1/robots/{robot}/zones": {
            "parameters": [robot],
            "get": asked("listZones", "Keep-out and speed zones of the robot's map.", "Zones"),
        },
        "/api/v1/robots/{robot}/zones/{zone}": {
            "parameters": [robot, zone],
            "put": taking("NewZone", asked("putZone", "Add a zone, or replace the one of this name. It acts on the plan that is driven too.", "Annotations")),
            "delete": removal("deleteZone", "Remove a zone, also one of the deployment's file."),
        },
    })
}

/// Paths of a robot's goals.
fn goal_paths() -> Value {
    let (robot, goal) = (in_path("robot", &id()), in_path("goal", &id()));
    let submit = operation(
        "submitGoal",
        "Submit a goal. It is stored before it is answered; the same `id` again is the same goal.",
        &[("202", "GoalReply", "Done.")],
        ASKED,
    );
    json!({
        "/api/v1/robots/{robot}/goals": {
            "parameters": [robot],
            "get": asked("listGoals", "Goals, newest first.", "Goals"),
            "post": taking("Goal", submit),
        },
        "/api/v1/robots/{robot}/goals/{goal}": {
            "parameters": [robot, goal],
            "get": asked("getGoal", "One goal.", "Object"),
            "delete": asked("cancelGoal", "Cancel a goal.", "GoalReply"),
        },
        "/api/v1/robots/{robot}/goals/{goal}/pause": {
            "parameters": [robot, goal],
            "post": asked("pauseGoal", "Pause a goal.", "GoalReply"),
        },
        "/api/v1/robots/{robot}/goals/{goal}/resume": {
            "parameters": [robot, goal],
            "post": asked("resumeGoal", "Let a paused goal go on.", "GoalReply"),
        },
        "/api/v1/robots/{robot}/goals/{goal}/move": {
            "parameters": [robot, goal],
            "post": taking("Move", asked("moveGoal", "Move a goal that waits before another one, or to the end of the queue; it takes the other's priority.", "GoalReply")),
        },
    })
}

/// A coordinate, m.
fn coordinate() -> Value {
    json!({ "type": "number", "minimum": -100_000, "maximum": 100_000 })
}

/// A type that may be missing.
fn optional(kind: &str) -> Value {
    json!({ "type": [kind, "null"] })
}

/// A list of the named schema.
fn list_of(schema: &str) -> Value {
    json!({ "type": "array", "items": { "$ref": format!("#/components/schemas/{schema}") } })
}

/// Points, poses and zones.
fn shape_schemas() -> Value {
    let point = json!({
        "type": "object", "required": ["x", "y"],
        "properties": {
            "x": coordinate(), "y": coordinate(), "yaw": { "type": ["number", "null"], "minimum": -TAU, "maximum": TAU },
        },
    });
    let rule = json!({ "oneOf": [
        { "const": "keep_out" },
        {
            "type": "object", "required": ["speed_limit"], "additionalProperties": false,
            "properties": { "speed_limit": {
                "type": "object", "required": ["max_speed"], "properties": { "max_speed": { "type": "number", "minimum": 0.01, "maximum": 100 } },
            } },
        },
    ] });
    let corners = json!({
        "type": "array", "minItems": 3, "maxItems": 1000,
        "items": { "type": "array", "minItems": 2, "maxItems": 2, "items": coordinate() },
    });
    let new_zone = json!({
        "type": "object", "required": ["rule", "points"], "additionalProperties": false,
        "description": "Corners of a simple polygon in order, map frame, m.",
        "properties": { "rule": rule, "points": corners },
    });
    let (mut place, mut zone) = (point.clone(), new_zone.clone());
    place["additionalProperties"] = false.into();
    zone["properties"]["name"] = json!({ "type": "string" });
    json!({
        "Object": { "type": "object" },
        "Point": point,
        "Place": place,
        "Pose": {
            "type": "object", "required": ["x", "y", "yaw"], "additionalProperties": false,
            "properties": { "x": coordinate(), "y": coordinate(), "yaw": { "type": "number", "minimum": -TAU, "maximum": TAU } },
        },
        "NewZone": new_zone,
        "Zone": zone,
    })
}

/// Bodies of requests besides shapes.
fn request_schemas() -> Value {
    json!({
        "Move": {
            "type": "object", "additionalProperties": false,
            "description": "The waiting goal that it is put before; without one, it becomes the last.",
            "properties": { "before": optional("string") },
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

/// Replies about the gateway and all robots.
fn fleet_schemas() -> Value {
    json!({
        "Error": {
            "type": "object", "required": ["error", "reason"],
            "properties": {
                "error": { "type": "string" }, "reason": { "type": "string" },
                "nearest_free": { "$ref": "#/components/schemas/Point" },
            },
        },
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
    })
}

/// Replies about one robot.
fn robot_schemas() -> Value {
    let objects = json!({ "type": "array", "items": { "type": "object" } });
    let places = json!({ "type": "object", "additionalProperties": { "$ref": "#/components/schemas/Point" } });
    json!({
        "Localisation": { "type": "object", "required": ["health"] },
        "Stopped": { "type": "object", "required": ["stopped"], "properties": { "stopped": { "type": "boolean" } } },
        "Events": { "type": "object", "required": ["events"], "properties": { "events": objects } },
        "Goals": { "type": "object", "required": ["goals"], "properties": { "goals": objects } },
        "Places": { "type": "object", "required": ["places"], "properties": { "places": places } },
        "Zones": { "type": "object", "required": ["zones"], "properties": { "zones": list_of("Zone") } },
        "Annotations": {
            "type": "object", "required": ["revision", "places", "zones"],
            "properties": { "revision": { "type": "integer" }, "places": places, "zones": list_of("Zone") },
        },
        "GoalReply": {
            "type": "object", "required": ["id", "state"],
            "properties": {
                "id": { "type": "string" }, "state": { "type": "string" }, "reason": { "type": "string" }, "robot": { "type": "string" },
            },
        },
    })
}
