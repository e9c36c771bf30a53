//! Triangles of a marching-cubes cell (Lorensen and Cline 1987).
//!
//! The 256 cases are derived from one rule instead of a table. On every face of the cell, the surface separates each run of
//! inside corners from the rest (Bloomenthal 1988). The rule depends only on the corners of the face, so two cells agree on
//! their common face and the surface has no cracks. The segments on the six faces form closed polygons.

use std::sync::LazyLock;

/// A triangle given by three edges, counter-clockwise seen from outside.
pub(crate) type EdgeTriangle = [u8; 3];

/// The triangles of each case. Bit c of the case is set if corner c is inside; bit a of c is the position of the corner along
/// axis a.
pub(crate) static TRIANGLES: LazyLock<Vec<Vec<EdgeTriangle>>> =
    LazyLock::new(|| (0..=255).map(triangles).collect());

/// The lower corner and the axis of each edge.
pub(crate) const EDGES: [(u8, usize); 12] = [
    (0, 0),
    (2, 0),
    (4, 0),
    (6, 0),
    (0, 1),
    (1, 1),
    (4, 1),
    (5, 1),
    (0, 2),
    (1, 2),
    (2, 2),
    (3, 2),
];

/// Returns the index of the edge between two corners.
fn edge(a: u8, b: u8) -> usize {
    let of = (a.min(b), (a ^ b).trailing_zeros() as usize);
    EDGES
        .iter()
        .position(|edge| *edge == of)
        .unwrap_or_default()
}

/// Returns the corners of the six faces, counter-clockwise seen from outside.
fn faces() -> impl Iterator<Item = [u8; 4]> {
    (0..3).flat_map(|axis| {
        let [u, v] = [1, 2].map(|next| 1_u8 << ((axis + next) % 3));
        let above = 1_u8 << axis;
        [
            [0, v, u | v, u],
            [above, above | u, above | u | v, above | v],
        ]
    })
}

fn triangles(case: u8) -> Vec<EdgeTriangle> {
    let inside = |corner: u8| case >> corner & 1 == 1;
    // The successor of each edge: on a face, from the edge after the last corner of an inside run to the edge before its first
    // corner. Neighbouring faces traverse a common edge in opposite directions, so each edge has one successor.
    let mut next = [None; 12];
    for face in faces() {
        for last in 0..4 {
            if !inside(face[last]) || inside(face[(last + 1) % 4]) {
                continue;
            }
            let mut first = last;
            while inside(face[(first + 3) % 4]) {
                first = (first + 3) % 4;
            }
            let left = edge(face[last], face[(last + 1) % 4]);
            next[left] = Some(edge(face[(first + 3) % 4], face[first]));
        }
    }
    let mut triangles = Vec::new();
    for start in 0..12 {
        let mut polygon = Vec::new();
        let mut at = start;
        while let Some(after) = next[at].take() {
            polygon.push(at as u8);
            at = after;
        }
        let fan = polygon.windows(2).skip(1);
        triangles.extend(fan.map(|pair| [polygon[0], pair[1], pair[0]]));
    }
    triangles
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::HashMap;

    fn middle(edge: u8) -> [f64; 3] {
        let (corner, axis) = EDGES[edge as usize];
        let mut place = [0, 1, 2].map(|a| f64::from(corner >> a & 1));
        place[axis] += 0.5;
        place
    }

    /// Compares the counts of Lorensen and Cline's 15 cases, for those without ambiguous faces.
    #[test]
    fn known_cases_have_their_triangles() {
        for (case, count) in [
            (0_u8, 0),
            (0b0000_0001, 1),
            (0b0000_0011, 2),
            (0b0000_0111, 3),
            (0b0000_1111, 2),
            (0b1000_0001, 2),
            (0b1111_1110, 1),
            (0b1111_1111, 0),
        ] {
            assert_eq!(TRIANGLES[usize::from(case)].len(), count, "{case:08b}");
        }
    }

    /// By the divergence theorem, the projected areas of the polygons follow from the sides of the corners alone if one corner
    /// is inside. In all cases, the border of the triangles lies on the faces, with each segment once.
    #[test]
    fn polygons_are_closed_and_face_outwards() {
        for (case, triangles) in TRIANGLES.iter().enumerate() {
            let crossed = EDGES.iter().filter(|(corner, axis)| {
                let inside = |corner: u8| case >> corner & 1;
                inside(*corner) != inside(corner | 1 << axis)
            });
            let mut used: Vec<u8> = triangles.iter().flatten().copied().collect();
            used.sort_unstable();
            used.dedup();
            assert_eq!(used.len(), crossed.count(), "{case:08b}");
            let mut border: HashMap<(u8, u8), i32> = HashMap::new();
            for [a, b, c] in triangles {
                for (from, to) in [(a, b), (b, c), (c, a)] {
                    *border.entry((*from.min(to), *from.max(to))).or_default() +=
                        if from < to { 1 } else { -1 };
                }
            }
            for ((a, b), count) in border.into_iter().filter(|(_, count)| *count != 0) {
                assert_eq!(count.abs(), 1, "{case:08b}");
                let [a, b] = [a, b].map(middle);
                let on_face =
                    |axis: usize| a[axis] == b[axis] && (a[axis] == 0.0 || a[axis] == 1.0);
                assert!((0..3).any(on_face), "{case:08b}");
            }
        }
        let [triangle] = TRIANGLES[1][..] else {
            panic!("one corner, one triangle")
        };
        let [a, b, c] = triangle.map(middle);
        let [u, v] = [b, c].map(|p| [0, 1, 2].map(|i| p[i] - a[i]));
        let normal =
            [0, 1, 2].map(|i| u[(i + 1) % 3] * v[(i + 2) % 3] - u[(i + 2) % 3] * v[(i + 1) % 3]);
        assert_eq!(normal, [0.25; 3]);
    }
}
