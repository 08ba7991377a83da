//! Suggestions. Which known name did the author mean? The one with the fewest edits (Levenshtein).

/// Longer names are not compared: the cost is the product of the two lengths.
const LONGEST: usize = 64;

/// The nearest of `names`, if it is near enough to be a typing mistake.
pub(super) fn nearest<'n>(name: &str, names: impl Iterator<Item = &'n str>) -> Option<&'n str> {
    let length = name.chars().count();
    if length > LONGEST {
        return None;
    }
    let reach = (length / 3).max(1);
    names
        .filter(|known| known.chars().count().abs_diff(length) <= reach)
        .map(|known| (edits(name, known), known))
        .filter(|(edits, _)| *edits <= reach)
        .min()
        .map(|(_, known)| known)
}

/// `, perhaps `X`` or nothing.
pub(super) fn hint<'n>(name: &str, names: impl Iterator<Item = &'n str>) -> String {
    nearest(name, names).map_or_else(String::new, |known| format!(", perhaps `{known}`"))
}

/// Edits between two names; a change of case counts half, rounded down over the whole name.
fn edits(one: &str, two: &str) -> usize {
    let two: Vec<char> = two.chars().collect();
    let mut row: Vec<usize> = (0..=two.len()).map(|index| 2 * index).collect();
    for (index, a) in one.chars().enumerate() {
        let mut diagonal = row[0];
        row[0] = 2 * (index + 1);
        for (column, b) in two.iter().enumerate() {
            let change = if a == *b {
                0
            } else if a.eq_ignore_ascii_case(b) {
                1
            } else {
                2
            };
            let best = (diagonal + change).min(row[column] + 2).min(row[column + 1] + 2);
            diagonal = std::mem::replace(&mut row[column + 1], best);
        }
    }
    row[two.len()] / 2
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
