//! Compose files. The parts as containers: all parts of a deployment on one engine, each with its own address, or the parts of one host on
//! that host's network.

use serde_json::{Map, Value, json};

use super::command_line::{Addresses, CONFIG, DATA, IDENTITY, Place, TOKEN, arguments, name};
use super::layout::{Host, Layout, METRICS_PORT};
use super::part::Part;
use crate::config::Profile;

/// The image of all parts.
pub(super) const IMAGE: &str = concat!("zenav:", env!("CARGO_PKG_VERSION"));
/// User of the processes in it.
pub(super) const USER: u32 = 65532;

/// All parts of a deployment on one engine. Robots in a served world have a second network for their bodies, which keeps working when the
/// fleet's is cut.
pub(super) fn whole(layout: &Layout<'_>) -> Value {
    let mut services = Map::new();
    let mut volumes = Map::new();
    for (host, part) in layout.parts() {
        let name = name(host, part);
        let mut service = service(layout, host, part, &Place::container(&name), "./etc");
        let mut networks = vec!["fleet"];
        if layout.world().is_some() && (*part == Part::World || layout.attaches(part)) {
            networks.push("bodies");
        }
        service.insert("networks".to_owned(), json!(networks));
        service.insert("hostname".to_owned(), json!(name));
        if let Some(port) = layout.page_port().filter(|_| *part == Part::Gateway) {
            // On a free port of this machine: `docker compose port` prints it.
            service.insert("ports".to_owned(), json!([port.to_string()]));
        }
        keep(&mut service, &mut volumes, &name, part);
        services.insert(name, Value::Object(service));
    }
    let mut networks = json!({ "fleet": {} });
    if layout.world().is_some() {
        networks["bodies"] = json!({ "internal": true });
    }
    json!({ "services": services, "networks": networks, "volumes": volumes })
}

/// The parts of one host, on the host's network.
pub(super) fn of_host(layout: &Layout<'_>, host: &Host) -> Value {
    let mut services = Map::new();
    let mut volumes = Map::new();
    for part in &host.parts {
        let name = part.name();
        let place = Place {
            addresses: Addresses::Hosts,
            metrics: format!("127.0.0.1:{}", host.metrics_port(part)),
            ..Place::container(&host.name)
        };
        let mut service = service(layout, host, part, &place, CONFIG);
        service.insert("network_mode".to_owned(), json!("host"));
        keep(&mut service, &mut volumes, &name, part);
        services.insert(name, Value::Object(service));
    }
    json!({ "services": services, "volumes": volumes })
}

/// A container without privileges, read-only but for its volume.
fn service(layout: &Layout<'_>, host: &Host, part: &Part, place: &Place, config: &str) -> Map<String, Value> {
    let port = match place.addresses {
        Addresses::Names => METRICS_PORT,
        Addresses::Hosts => host.metrics_port(part),
    };
    let mut mounts = vec![format!("{config}:{CONFIG}:ro")];
    if layout.profile == Profile::Mtls {
        let keys = match place.addresses {
            // The certificate authority's own folder, on the machine that rehearses the deployment.
            Addresses::Names => "${ZENAV_KEYS:-./fleet-keys}/issued",
            Addresses::Hosts => IDENTITY,
        };
        mounts.push(format!("{keys}/{}:{IDENTITY}:ro", layout.identity(host, part)));
    }
    if let Some(token) = layout.token_file().filter(|_| *part == Part::Gateway) {
        let file = match place.addresses {
            Addresses::Names => "${ZENAV_PAGE_TOKEN:-./page-token}".to_owned(),
            Addresses::Hosts => token.display().to_string(),
        };
        mounts.push(format!("{file}:{TOKEN}:ro"));
    }
    let service = json!({
        "image": format!("${{ZENAV_IMAGE:-{IMAGE}}}"),
        "command": arguments(layout, host, part, place),
        "working_dir": CONFIG,
        "user": format!("{USER}:{USER}"),
        "read_only": true,
        "cap_drop": ["ALL"],
        "security_opt": ["no-new-privileges:true"],
        "restart": "unless-stopped",
        "stop_grace_period": "15s",
        "volumes": mounts,
        "healthcheck": {
            "test": ["CMD", "/zenav", "deploy", "health", format!("127.0.0.1:{port}")],
            "interval": "5s",
            "timeout": "3s",
            "start_period": "30s",
            "retries": 3,
        },
    });
    match service {
        Value::Object(service) => service,
        _ => Map::new(),
    }
}

/// Adds a volume for the part's data.
fn keep(service: &mut Map<String, Value>, volumes: &mut Map<String, Value>, name: &str, part: &Part) {
    if !part.keeps_data() {
        return;
    }
    if let Some(Value::Array(mounts)) = service.get_mut("volumes") {
        mounts.push(json!(format!("{name}:{DATA}")));
    }
    volumes.insert(name.to_owned(), json!({}));
}
