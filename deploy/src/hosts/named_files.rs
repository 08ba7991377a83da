//! Named files. Files that a deployment names and its hosts need too. They are beside the deployment file, and are copied with it to
//! `/etc/zenav`, where parts find them by the same names.

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Component, Path};

use zenav_protocol::config_text::OutOfBounds;
use zenav_protocol::robot;
use zenav_sim::world;

use crate::config::Deployment;
use crate::failure::Failure;
use crate::files::{Shipped, names};
use crate::output::listed;

/// Largest file copied, bytes: a map of a large building.
const MOST: u64 = 64 * 1024 * 1024;

/// Names of the files in `folder` that a deployment names, sorted.
///
/// # Errors
/// Names without a file there, by key.
pub(super) fn of(deployment: &Deployment, folder: &Path) -> Result<Vec<String>, Vec<OutOfBounds>> {
    let mut found = BTreeSet::new();
    let mut problems = Vec::new();
    // The key that names each file.
    let mut keys = BTreeMap::new();
    let mut name = |key: String, name: &str, is_shipped: bool, shipped: Shipped| {
        let is_plain = is_plain(name);
        let problem = if folder.join(name).is_file() && is_plain {
            found.insert(name.to_owned());
            keys.insert(name.to_owned(), key);
            return;
        } else if is_shipped {
            return;
        } else if !is_plain {
            "a path: expected a file beside the deployment file, from where it goes to all hosts".to_owned()
        } else if shipped.is_empty() {
            "expected a file beside the deployment file".to_owned()
        } else {
            format!(
                "expected a file beside the deployment file, or one of {}",
                listed(names(shipped))
            )
        };
        problems.push(OutOfBounds {
            key,
            problem: format!("is `{name}`: {problem}"),
        });
    };
    let simulated = deployment.robots.values().any(|robot| !robot.driver);
    let places = &deployment.simulation.world;
    name(
        "simulation.world".to_owned(),
        places,
        world::shipped(places).is_some() || (!simulated && places.is_empty()),
        world::SHIPPED,
    );
    for (id, section) in &deployment.robots {
        for (place, part) in section.model.split('+').enumerate() {
            let known = if place == 0 { robot::SHIPPED } else { robot::OPTIONS };
            let is_shipped = names(robot::SHIPPED)
                .chain(names(robot::OPTIONS))
                .any(|known| known == part);
            name(format!("robots.{id}.model"), part, is_shipped, known);
        }
    }
    for (key, file) in deployment.files() {
        if let Some(file) = file {
            name(key.to_owned(), &file.to_string_lossy(), false, &[]);
        }
    }
    if !problems.is_empty() {
        return Err(problems);
    }
    // A map, or a world made from one, consists of a description and an image.
    for name in found.clone() {
        let images = images(&folder.join(&name));
        for image in images.into_iter().filter(|image| folder.join(image).is_file()) {
            if is_plain(&image) {
                found.insert(image);
            } else {
                problems.push(OutOfBounds {
                    key: keys.get(&name).cloned().unwrap_or_default(),
                    problem: format!(
                        "is `{name}`, which names `{image}`: expected a file beside it, by its name alone"
                    ),
                });
            }
        }
    }
    if problems.is_empty() {
        Ok(found.into_iter().collect())
    } else {
        Err(problems)
    }
}

/// Whether a name is that of a file directly in the folder.
fn is_plain(name: &str) -> bool {
    let mut parts = Path::new(name).components();
    matches!((parts.next(), parts.next()), (Some(Component::Normal(_)), None)) && !name.starts_with('.')
}

/// Files that a file itself names: the image of a map's description, the description of a world's map.
pub(crate) fn images(file: &Path) -> Vec<String> {
    let Ok(text) = std::fs::read_to_string(file) else {
        return Vec::new();
    };
    let named = text.lines().filter_map(|line| {
        let (key, value) = line.split_once([':', '='])?;
        let value = value.split('#').next()?.trim().trim_matches(['"', '\'']);
        matches!(key.trim(), "image" | "yaml").then(|| value.to_owned())
    });
    let named: Vec<String> = named.collect();
    let deeper = named
        .iter()
        .filter(|name| name.ends_with(".yaml"))
        .flat_map(|name| images(&file.with_file_name(name)));
    let deeper: Vec<String> = deeper.collect();
    [named, deeper].concat()
}

/// Copies the named files of a folder, and the deployment file as `deployment.toml`.
///
/// # Errors
/// A file that cannot be read or written, or is larger than a map of a building.
pub(super) fn copy(deployment: &Path, names: &[String], into: &Path) -> Result<(), Failure> {
    std::fs::create_dir_all(into).map_err(Failure::failed_at(into))?;
    let folder = deployment.parent().unwrap_or_else(|| Path::new("."));
    let named = names.iter().map(|name| (folder.join(name), into.join(name)));
    let own = (deployment.to_owned(), into.join("deployment.toml"));
    for (from, to) in std::iter::once(own).chain(named) {
        let size = std::fs::metadata(&from).map_err(Failure::failed_at(&from))?.len();
        if size > MOST {
            return Err(Failure::usage(format!(
                "{}: expected at most {MOST} bytes",
                from.display()
            )));
        }
        // Read before it is written: it may be the same file.
        let bytes = std::fs::read(&from).map_err(Failure::failed_at(&from))?;
        crate::files::write(&to, bytes)?;
    }
    Ok(())
}
