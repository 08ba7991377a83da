//! Suggestions. Which known name did the author mean? The one with the fewest edits, whatever the case.

/// Longer names are not compared: the cost is the product of the two lengths.
const LONGEST: usize = 64;

/// The nearest of `names`, if it is near enough to be a typing mistake.
pub(super) fn nearest<'n>(name: &str, names: impl Iterator<Item = &'n str>) -> Option<&'n str> {
    let length = name.chars().count();
    if length > LONGEST {
        return None;
    }
    let reach = (length / 3).max(1);
    let name = name.to_lowercase();
    names
        .filter(|known| known.chars().count().abs_diff(length) <= reach)
        .map(|known| (strsim::osa_distance(&name, &known.to_lowercase()), known))
        .filter(|(edits, _)| *edits <= reach)
        .min()
        .map(|(_, known)| known)
}

/// `, perhaps `X`` or nothing.
pub(super) fn hint<'n>(name: &str, names: impl Iterator<Item = &'n str>) -> String {
    nearest(name, names).map_or_else(String::new, |known| format!(", perhaps `{known}`"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_slip_is_recognised_and_a_stranger_is_not() {
        let names = ["Sequence", "ReactiveSequence", "Fallback", "Inverter"];
        assert_eq!(nearest("Sequense", names.into_iter()), Some("Sequence"));
        assert_eq!(nearest("fallback", names.into_iter()), Some("Fallback"));
        assert_eq!(nearest("Selector", names.into_iter()), None);
        assert_eq!(nearest(&"x".repeat(10_000), names.into_iter()), None);
    }
}
