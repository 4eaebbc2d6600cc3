//! Suggestions for a mistyped name: the valid names that it may have meant.

/// A name as a text shows it, cut to 80 characters.
pub fn cut(name: &str) -> String {
    if name.chars().count() <= 80 {
        return name.to_string();
    }
    name.chars().take(79).chain(['…']).collect()
}

/// "; nearest: a, b" out of the valid names, for a name that is not among them.
pub fn nearest(name: &str, known: &[&str]) -> String {
    // The time of the comparison grows with the length.
    let name = &cut(name);
    let mut near: Vec<(usize, &str)> = known
        .iter()
        .map(|other| (edits(name, other), *other))
        .filter(|(distance, other)| distance * 2 <= name.len().max(other.len()))
        .collect();
    near.sort();
    let names: Vec<&str> = near.iter().take(3).map(|(_, name)| *name).collect();
    if names.is_empty() {
        format!("; known: {}", known.join(", "))
    } else {
        format!("; nearest: {}", names.join(", "))
    }
}

/// The number of letters to insert, drop or change to get from one name to the other.
fn edits(a: &str, b: &str) -> usize {
    let b: Vec<char> = b.chars().collect();
    let mut row: Vec<usize> = (0..=b.len()).collect();
    for (i, x) in a.chars().enumerate() {
        let mut diagonal = row[0];
        row[0] = i + 1;
        for (j, y) in b.iter().enumerate() {
            let change = diagonal + usize::from(x != *y);
            diagonal = row[j + 1];
            row[j + 1] = change.min(row[j] + 1).min(diagonal + 1);
        }
    }
    row[b.len()]
}
