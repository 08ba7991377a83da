//! Untrusted input. What holds for any bytes that arrive as a message or are read as a file? They are taken or refused, soon and without a
//! panic, and what was taken can be written and read again.
//!
//! The fuzz targets of `tests/fuzz` call these functions, and so does an ordinary test (`tests/tests/untrusted.rs`) with seeds that it
//! changes a little.
//!
//! | module | input |
//! |---|---|
//! | [`wire`] | the payload of any key, as JSON and as CBOR |
//! | [`identities`] | certificates, lists of members |
//! | [`mission`] | requests, messages and answers to a mission, one after another |
//! | [`pilot`] | requests, plans and messages to a robot, one after another |
//! | [`routes`] | requests to the mission-control page's server, its WebSocket, and a health endpoint |
//! | [`settings`] | files of robots, worlds and zones |
//! | [`deployments`] | deployment files |
//! | [`maps`] | map images with their descriptions, Moving AI maps |
//! | [`logs`] | CARMEN logs, pose graphs, relations, SLAM sessions |
//! | [`records`] | records of runs, as `zenav replay` and `zenav report` read them |
//! | [`scripts`] | scripts of `zenav netem` |

pub mod deployments;
pub mod identities;
pub mod logs;
pub mod maps;
pub mod mission;
pub mod pilot;
pub mod records;
pub mod routes;
pub mod scripts;
pub mod settings;
pub mod wire;

/// A kind of input.
#[derive(Clone, Copy, Debug)]
pub struct Family {
    /// Name of its fuzz target.
    pub name: &'static str,
    /// Gives bytes to all readers of this kind; returns how many of them took the bytes.
    pub exercise: fn(&[u8]) -> usize,
    /// Valid input to begin with: each is taken by a reader.
    pub seeds: fn() -> Vec<Vec<u8>>,
}

/// All kinds of input.
pub const FAMILIES: &[Family] = &[
    Family {
        name: "wire",
        exercise: wire::exercise,
        seeds: wire::seeds,
    },
    Family {
        name: "identities",
        exercise: identities::exercise,
        seeds: identities::seeds,
    },
    Family {
        name: "mission",
        exercise: mission::exercise,
        seeds: mission::seeds,
    },
    Family {
        name: "pilot",
        exercise: pilot::exercise,
        seeds: pilot::seeds,
    },
    Family {
        name: "routes",
        exercise: routes::exercise,
        seeds: routes::seeds,
    },
    Family {
        name: "settings",
        exercise: settings::exercise,
        seeds: settings::seeds,
    },
    Family {
        name: "deployments",
        exercise: deployments::exercise,
        seeds: deployments::seeds,
    },
    Family {
        name: "maps",
        exercise: maps::exercise,
        seeds: maps::seeds,
    },
    Family {
        name: "logs",
        exercise: logs::exercise,
        seeds: logs::seeds,
    },
    Family {
        name: "records",
        exercise: records::exercise,
        seeds: records::seeds,
    },
    Family {
        name: "scripts",
        exercise: scripts::exercise,
        seeds: scripts::seeds,
    },
];
