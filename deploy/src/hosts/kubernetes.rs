//! Kubernetes manifests. The parts of cloud and edge sites in a cluster: a kustomize base with one workload per part, probes, resources,
//! disruption budgets, network policies, and autoscaled motion workers.
//!
//! Robots and operators are outside the cluster and reach the routers' services. Differences between clusters (number of workers, storage
//! classes, exposing the page) are overlays on the base in kustomize.

use std::collections::BTreeSet;

use serde_json::{Value, json};

use super::command_line::{CONFIG, DATA, IDENTITY, Place, TOKEN, arguments, name};
use super::compose::USER;
use super::layout::{Host, Layout, METRICS_PORT, ROUTER_PORT, WORLD_PORT};
use super::part::Part;
use crate::config::{Profile, Role};

/// Label of everything that belongs to zenav.
const APP: &str = "app.kubernetes.io/name";
/// Label of a part's kind.
const COMPONENT: &str = "app.kubernetes.io/component";
/// Label of one part.
const INSTANCE: &str = "app.kubernetes.io/instance";
/// Secret with the page's token.
pub(super) const PAGE_SECRET: &str = "zenav-page";
/// Most motion workers of a host.
const MOST_WORKERS: u32 = 8;
/// Load that starts another motion worker, percent of a worker's requested processor time.
const BUSY: u32 = 70;

/// Files of the base by name; `config` are the files mounted into every part.
pub(super) fn base(layout: &Layout<'_>, config: &[String]) -> Vec<(String, Value)> {
    let hosts = layout
        .hosts
        .iter()
        .filter(|host| matches!(host.role, Role::Cloud | Role::EdgeSite));
    let parts: Vec<(&Host, &Part)> = hosts
        .flat_map(|host| host.parts.iter().map(move |part| (host, part)))
        .collect();
    let mut files = Vec::new();
    for (host, part) in &parts {
        files.push((
            format!("{}.yaml", name(host, part)),
            Value::Array(of_part(layout, host, part)),
        ));
    }
    let kinds: BTreeSet<&str> = parts.iter().map(|(_, part)| part.kind()).collect();
    files.push(("disruption.yaml".to_owned(), disruption_budgets(&kinds)));
    files.push(("network.yaml".to_owned(), network_policies(layout, &kinds)));
    let resources: Vec<&String> = files.iter().map(|(file, _)| file).collect();
    let kustomization = json!({
        "apiVersion": "kustomize.config.k8s.io/v1beta1",
        "kind": "Kustomization",
        "namespace": "zenav",
        "resources": resources,
        "configMapGenerator": [{ "name": "zenav", "files": config }],
        "images": [{ "name": "zenav", "newTag": env!("CARGO_PKG_VERSION") }],
    });
    files.insert(0, ("kustomization.yaml".to_owned(), kustomization));
    files
}

/// Requested processor and memory of a part, and its memory limit.
fn resources(part: &Part) -> (&'static str, &'static str, &'static str) {
    match part {
        Part::Router => ("100m", "64Mi", "512Mi"),
        Part::World | Part::Edge(_) => ("500m", "128Mi", "512Mi"),
        Part::Mapping(_) => ("250m", "128Mi", "2Gi"),
        Part::Motion => ("500m", "128Mi", "1Gi"),
        Part::Mission(_) => ("250m", "128Mi", "1Gi"),
        Part::Gateway => ("100m", "64Mi", "512Mi"),
    }
}

fn labels(instance: &str, part: &Part) -> Value {
    json!({ APP: "zenav", COMPONENT: part.kind(), INSTANCE: instance })
}

/// Workload, service and autoscaler for a part.
fn of_part(layout: &Layout<'_>, host: &Host, part: &Part) -> Vec<Value> {
    let name = name(host, part);
    let mut spec = json!({
        "selector": { "matchLabels": labels(&name, part) },
        "template": {
            "metadata": { "labels": labels(&name, part) },
            "spec": pod(layout, host, part, &name),
        },
    });
    if *part != Part::Motion {
        // Motion replicas are controlled by the autoscaler.
        spec["replicas"] = json!(1);
    }
    let kind = if part.keeps_data() {
        spec["serviceName"] = json!(name);
        spec["volumeClaimTemplates"] = json!([{
            "metadata": { "name": "data" },
            "spec": { "accessModes": ["ReadWriteOnce"], "resources": { "requests": { "storage": "1Gi" } } },
        }]);
        "StatefulSet"
    } else {
        spec["strategy"] = match part {
            // Two at once under one name would be two routers, or two worlds.
            Part::Router | Part::World => json!({ "type": "Recreate" }),
            _ => json!({ "type": "RollingUpdate", "rollingUpdate": { "maxSurge": 1, "maxUnavailable": 0 } }),
        };
        "Deployment"
    };
    let mut all = vec![json!({
        "apiVersion": "apps/v1",
        "kind": kind,
        "metadata": { "name": name, "labels": labels(&name, part) },
        "spec": spec,
    })];
    if let Some(ports) = service_ports(layout, part) {
        let from_outside = *part == Part::World && has_robots_outside(layout);
        let kind = if *part == Part::Router || from_outside {
            "LoadBalancer"
        } else {
            "ClusterIP"
        };
        all.push(service(&name, part, json!({ "type": kind, "ports": ports })));
    } else if part.keeps_data() {
        all.push(service(
            &name,
            part,
            json!({ "clusterIP": "None", "ports": [{ "name": "metrics", "port": METRICS_PORT, "targetPort": "metrics" }] }),
        ));
    }
    if *part == Part::Motion {
        all.push(autoscaler(&name, part));
    }
    all
}

fn service(name: &str, part: &Part, mut spec: Value) -> Value {
    spec["selector"] = labels(name, part);
    json!({
        "apiVersion": "v1",
        "kind": "Service",
        "metadata": { "name": name, "labels": labels(name, part) },
        "spec": spec,
    })
}

/// Ports at which other parts reach a part.
fn service_ports(layout: &Layout<'_>, part: &Part) -> Option<Value> {
    let port = match part {
        Part::Router => ROUTER_PORT,
        Part::World => WORLD_PORT,
        Part::Gateway => layout.page_port()?,
        _ => return None,
    };
    let (name, protocol) = match part {
        Part::Gateway => ("page", "TCP"),
        _ => ("zenoh", layout.transport()),
    };
    Some(json!([{ "name": name, "port": port, "protocol": protocol, "targetPort": name }]))
}

fn pod(layout: &Layout<'_>, host: &Host, part: &Part, name: &str) -> Value {
    let mut place = Place::container(name);
    // Replaced with the container's variable of that name.
    place.worker = "$(POD_NAME)".to_owned();
    let mut ports = vec![json!({ "name": "metrics", "containerPort": METRICS_PORT })];
    if let Some(own) = service_ports(layout, part) {
        ports.push(json!({ "name": own[0]["name"], "containerPort": own[0]["port"], "protocol": own[0]["protocol"] }));
    }
    let mut mounts = vec![json!({ "name": "config", "mountPath": CONFIG, "readOnly": true })];
    let mut volumes = vec![json!({ "name": "config", "configMap": { "name": "zenav" } })];
    if part.keeps_data() {
        mounts.push(json!({ "name": "data", "mountPath": DATA }));
    }
    if layout.profile == Profile::Mtls {
        mounts.push(json!({ "name": "identity", "mountPath": IDENTITY, "readOnly": true }));
        let secret = super::part::label(&layout.identity(host, part));
        volumes.push(json!({ "name": "identity", "secret": { "secretName": secret, "defaultMode": 0o440 } }));
    }
    if *part == Part::Gateway && layout.token_file().is_some() {
        let folder = TOKEN.trim_end_matches("/token");
        mounts.push(json!({ "name": "page", "mountPath": folder, "readOnly": true }));
        volumes.push(json!({ "name": "page", "secret": { "secretName": PAGE_SECRET, "defaultMode": 0o440 } }));
    }
    let (cpu, memory, most) = resources(part);
    let probe = |path: &str, period: u32, failures: u32| {
        json!({
            "httpGet": { "path": path, "port": "metrics" },
            "periodSeconds": period,
            "timeoutSeconds": 3,
            "failureThreshold": failures,
        })
    };
    json!({
        "automountServiceAccountToken": false,
        // Their variables would be read as settings: ZENAV_...
        "enableServiceLinks": false,
        "terminationGracePeriodSeconds": 15,
        "securityContext": {
            "runAsNonRoot": true,
            "runAsUser": USER,
            "runAsGroup": USER,
            "fsGroup": USER,
            "seccompProfile": { "type": "RuntimeDefault" },
        },
        "topologySpreadConstraints": [{
            "maxSkew": 1,
            "topologyKey": "kubernetes.io/hostname",
            "whenUnsatisfiable": "ScheduleAnyway",
            "labelSelector": { "matchLabels": { APP: "zenav", COMPONENT: part.kind() } },
        }],
        "containers": [{
            "name": part.kind(),
            "image": "zenav",
            "args": arguments(layout, host, part, &place),
            "workingDir": CONFIG,
            "env": [{ "name": "POD_NAME", "valueFrom": { "fieldRef": { "fieldPath": "metadata.name" } } }],
            "ports": ports,
            "startupProbe": probe("/livez", 2, 30),
            "livenessProbe": probe("/livez", 5, 4),
            "readinessProbe": probe("/readyz", 5, 2),
            "resources": {
                "requests": { "cpu": cpu, "memory": memory },
                "limits": { "memory": most },
            },
            "securityContext": {
                "allowPrivilegeEscalation": false,
                "readOnlyRootFilesystem": true,
                "capabilities": { "drop": ["ALL"] },
            },
            "volumeMounts": mounts,
        }],
        "volumes": volumes,
    })
}

fn autoscaler(name: &str, part: &Part) -> Value {
    json!({
        "apiVersion": "autoscaling/v2",
        "kind": "HorizontalPodAutoscaler",
        "metadata": { "name": name, "labels": labels(name, part) },
        "spec": {
            "scaleTargetRef": { "apiVersion": "apps/v1", "kind": "Deployment", "name": name },
            "minReplicas": 1,
            "maxReplicas": MOST_WORKERS,
            "metrics": [{
                "type": "Resource",
                "resource": { "name": "cpu", "target": { "type": "Utilization", "averageUtilization": BUSY } },
            }],
        },
    })
}

/// Whether a robot of the served world runs on its own machine, outside the cluster.
fn has_robots_outside(layout: &Layout<'_>) -> bool {
    let mut parts = layout.parts();
    parts.any(|(host, part)| host.role == Role::Robot && layout.attaches(part))
}

/// At most one pod of a kind is evicted at a time: the other router, worker or orchestrator keeps running.
fn disruption_budgets(kinds: &BTreeSet<&str>) -> Value {
    let budget = |kind: &&str| {
        json!({
            "apiVersion": "policy/v1",
            "kind": "PodDisruptionBudget",
            "metadata": { "name": format!("zenav-{kind}") },
            "spec": {
                "maxUnavailable": 1,
                "selector": { "matchLabels": { APP: "zenav", COMPONENT: kind } },
            },
        })
    };
    Value::Array(kinds.iter().map(budget).collect())
}

/// Allowed traffic to pods: routers from anywhere, the world from its robots, the page from anywhere (it requires a token), health and
/// metrics from the cluster. If robots of the world run outside the cluster, the world from anywhere too.
fn network_policies(layout: &Layout<'_>, kinds: &BTreeSet<&str>) -> Value {
    let policy = |name: &str, selected: Value, ingress: Value| {
        json!({
            "apiVersion": "networking.k8s.io/v1",
            "kind": "NetworkPolicy",
            "metadata": { "name": name },
            "spec": {
                "podSelector": { "matchLabels": selected },
                "policyTypes": ["Ingress"],
                "ingress": ingress,
            },
        })
    };
    let tcp = |port: u16| json!([{ "protocol": "TCP", "port": port }]);
    let zenoh = |port: u16| json!([{ "protocol": layout.transport(), "port": port }]);
    let of_kind = |kind: &str| json!({ APP: "zenav", COMPONENT: kind });
    let metrics = json!([{ "from": [{ "namespaceSelector": {} }], "ports": tcp(METRICS_PORT) }]);
    let mut all = vec![policy("zenav", json!({ APP: "zenav" }), metrics)];
    if kinds.contains("router") {
        all.push(policy(
            "zenav-router",
            of_kind("router"),
            json!([{ "ports": zenoh(ROUTER_PORT) }]),
        ));
    }
    if kinds.contains("world") {
        let robots = json!([{ "podSelector": { "matchLabels": of_kind("edge") } }]);
        let mut from = json!({ "ports": zenoh(WORLD_PORT) });
        if !has_robots_outside(layout) {
            from["from"] = robots;
        }
        all.push(policy("zenav-world", of_kind("world"), json!([from])));
    }
    if let Some(port) = layout.page_port().filter(|_| kinds.contains("gateway")) {
        all.push(policy(
            "zenav-gateway",
            of_kind("gateway"),
            json!([{ "ports": tcp(port) }]),
        ));
    }
    Value::Array(all)
}
