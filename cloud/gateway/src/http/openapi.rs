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

fn asked(id: &str, summary: &str, status: &str, schema: &str) -> Value {
    operation(id, summary, &[(status, schema, "Done.")], ASKED)
}

/// Adds a request body with the named schema, and the errors of invalid bodies.
fn takes(operation: &mut Value, schema: &str) {
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
}

/// A name given by people.
fn given_name(name: &str) -> Value {
    json!({
        "name": name, "in": "path", "required": true,
        "schema": { "type": "string", "minLength": 1, "maxLength": 64 },
    })
}

fn name_in_path(name: &str) -> Value {
    json!({
        "name": name, "in": "path", "required": true,
        "schema": { "type": "string", "pattern": "^[A-Za-z0-9_-]{1,64}$" },
    })
}

/// The OpenAPI document.
pub(super) fn openapi() -> Value {
    let (robot, goal) = (name_in_path("robot"), name_in_path("goal"));
    let mut submit = asked(
        "submitGoal",
        "Submit a goal. It is stored before it is answered; the same `id` again is the same goal.",
        "202",
        "GoalReply",
    );
    takes(&mut submit, "Goal");
    let mut move_goal = asked(
        "moveGoal",
        "Move a goal that waits before another one, or to the end of the queue; it takes the other's priority.",
        "200",
        "GoalReply",
    );
    takes(&mut move_goal, "Move");
    let mut set_pose = asked(
        "setPose",
        "Tell the robot where it is, to within some decimetres: it drops its plan, and goes on from there.",
        "200",
        "Localisation",
    );
    takes(&mut set_pose, "Pose");
    let mut put_place = asked(
        "putPlace",
        "Add a place, or move the one of this name.",
        "200",
        "Annotations",
    );
    takes(&mut put_place, "Place");
    let mut put_zone = asked(
        "putZone",
        "Add a zone, or replace the one of this name. It acts on the plan that is driven too.",
        "200",
        "Annotations",
    );
    takes(&mut put_zone, "NewZone");
    let removal = |id: &str, summary: &str| {
        let mut removal = asked(id, summary, "200", "Annotations");
        removal["responses"]["400"] = reply("Error", "Not a name.");
        removal
    };
    let (place, zone) = (given_name("place"), given_name("zone"));
    let read = |id: &str, summary: &str, schema: &str| operation(id, summary, &[("200", schema, "Read.")], &[]);
    let mut stop_all = operation(
        "stopAll",
        "Stop every robot that shows.",
        &[("200", "Stops", "All stopped.")],
        &[],
    );
    stop_all["responses"]["503"] = reply(
        "Stops",
        "No robot is known, or the router is out of reach: all that are known are stopped.",
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
            "/api/v1/robots/{robot}/pose": { "parameters": [robot], "post": set_pose },
            "/api/v1/robots/{robot}/places": {
                "parameters": [robot],
                "get": asked("listPlaces", "Named places of the robot's map.", "200", "Places"),
            },
            "/api/v1/robots/{robot}/places/{place}": {
                "parameters": [robot, place],
                "put": put_place,
                "delete": removal("deletePlace", "Remove a place, also one of the world."),
            },
            "/api/v1/robots/{robot}/zones": {
                "parameters": [robot],
                "get": asked("listZones", "Keep-out and speed zones of the robot's map.", "200", "Zones"),
            },
            "/api/v1/robots/{robot}/zones/{zone}": {
                "parameters": [robot, zone],
                "put": put_zone,
                "delete": removal("deleteZone", "Remove a zone, also one of the deployment's file."),
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
            "/api/v1/robots/{robot}/goals/{goal}/move": { "parameters": [robot, goal], "post": move_goal },
            "/api/v1/live": { "get": live },
        },
        "components": {
            "securitySchemes": { "token": { "type": "http", "scheme": "bearer" } },
            "schemas": schemas(),
        },
    })
}

fn schemas() -> Value {
    let coordinate = json!({ "type": "number", "minimum": -100_000, "maximum": 100_000 });
    let optional = |kind: &str| json!({ "type": [kind, "null"] });
    let point = json!({
        "type": "object", "required": ["x", "y"],
        "properties": {
            "x": coordinate, "y": coordinate, "yaw": { "type": ["number", "null"], "minimum": -TAU, "maximum": TAU },
        },
    });
    let rule = json!({ "oneOf": [
        { "const": "keep_out" },
        {
            "type": "object", "required": ["speed_limit"], "additionalProperties": false,
            "properties": { "speed_limit": {
                "type": "object", "required": ["max_speed"], "properties": { "max_speed": { "type": "number", "exclusiveMinimum": 0 } },
            } },
        },
    ] });
    let corners = json!({
        "type": "array", "minItems": 3, "maxItems": 1000,
        "items": { "type": "array", "minItems": 2, "maxItems": 2, "items": coordinate },
    });
    let zone = |more: &[(&str, Value)]| {
        let mut zone = json!({
            "type": "object", "required": ["rule", "points"], "additionalProperties": false,
            "description": "Corners of a simple polygon in order, map frame, m.",
            "properties": { "rule": rule, "points": corners },
        });
        for (name, schema) in more {
            zone["properties"][*name] = schema.clone();
        }
        zone
    };
    let mut place = point.clone();
    place["additionalProperties"] = false.into();
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
        "Pose": {
            "type": "object", "required": ["x", "y", "yaw"], "additionalProperties": false,
            "properties": { "x": coordinate, "y": coordinate, "yaw": { "type": "number", "minimum": -TAU, "maximum": TAU } },
        },
        "Localisation": { "type": "object", "required": ["health"] },
        "NewZone": zone(&[]),
        "Zone": zone(&[("name", json!({ "type": "string" }))]),
        "Place": place,
        "Zones": {
            "type": "object", "required": ["zones"],
            "properties": { "zones": { "type": "array", "items": { "$ref": "#/components/schemas/Zone" } } },
        },
        "Places": {
            "type": "object", "required": ["places"],
            "properties": { "places": { "type": "object", "additionalProperties": { "$ref": "#/components/schemas/Point" } } },
        },
        "Annotations": {
            "type": "object", "required": ["revision", "places", "zones"],
            "properties": {
                "revision": { "type": "integer" },
                "places": { "type": "object", "additionalProperties": { "$ref": "#/components/schemas/Point" } },
                "zones": { "type": "array", "items": { "$ref": "#/components/schemas/Zone" } },
            },
        },
        "Move": {
            "type": "object", "additionalProperties": false,
            "description": "The waiting goal that it is put before; without one, it becomes the last.",
            "properties": { "before": optional("string") },
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
