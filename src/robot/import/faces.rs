//! Faces of the reach of a foot with a sole: a box whose edges along y are cut by diagonal faces, because a leg that bends one way does not
//! attain the corners of a large box. `cregopt.mujoco` uses the same rules and numbers.

use crate::robot::{FootReach, Slab};

/// Number of faces.
const COUNT: usize = 10;
/// Outward normals of the faces in the order in which they grow: x forward, y outward, z up. Each face follows its opposite.
const NORMALS: [[f64; 3]; COUNT] = [
    [1., 0., 0.],
    [-1., 0., 0.],
    [0., 0., 1.],
    [0., 0., -1.],
    [0.6, 0., 0.8],
    [-0.6, 0., -0.8],
    [-0.6, 0., 0.8],
    [0.6, 0., -0.8],
    [0., 1., 0.],
    [0., -1., 0.],
];
/// Number of faces along y, which are the others.
const ALONG_Y: usize = 8;
/// First growth step relative to the largest distance of a face.
const FIRST_STEP: f64 = 0.125;
/// Number of times that the step is halved before a face stops growing.
const HALVINGS: usize = 4;
/// Number of parts of an edge of the outline in the x-z plane whose ends are checked.
const PARTS: usize = 4;

/// Distances of the faces from the nominal position, m.
pub type Faces = [f64; COUNT];

/// Sides of a box as distances from the nominal position, m: rear, inner, lower side; front, outer, upper side.
pub type Sides = [[f64; 3]; 2];

/// Distances of faces that touch the outermost of some points.
///
/// * `points` - coordinates in the box, not negative, as shares of its sides; each represents its mirror images
pub fn around(sides: &Sides, points: &[[f64; 3]]) -> Faces {
    let along = |normal: [f64; 3], point: &[f64; 3]| -> f64 {
        (0..3).map(|axis| normal[axis].abs() * point[axis] * sides[usize::from(normal[axis] > 0.)][axis]).sum()
    };
    NORMALS.map(|normal| points.iter().map(|point| along(normal, point)).fold(0., f64::max))
}

/// Corners of the outline in the x-z plane, in order, m.
fn outline(faces: &Faces) -> Vec<[f64; 2]> {
    let mut corners = Vec::new();
    for i in 0..ALONG_Y {
        for j in 0..i {
            let ([a, _, b], [c, _, d]) = (NORMALS[i], NORMALS[j]);
            let determinant = a * d - b * c;
            if determinant.abs() > 1e-9 {
                let corner = [(d * faces[i] - b * faces[j]) / determinant, (a * faces[j] - c * faces[i]) / determinant];
                if (0..ALONG_Y).all(|face| along(face, corner) < faces[face] + 1e-9) {
                    corners.push(corner);
                }
            }
        }
    }
    corners.sort_by(|[x, z], [u, v]| z.atan2(*x).total_cmp(&v.atan2(*u)));
    corners
}

/// Coordinate of a point of the x-z plane along the normal of a face, m.
fn along(face: usize, [x, z]: [f64; 2]) -> f64 {
    NORMALS[face][0] * x + NORMALS[face][2] * z
}

/// Points at which the faces are checked: x and z in m, y as a share of the outer or, negative, the inner distance. Of length and width, at
/// most one is used in full at a time.
pub fn points(faces: &Faces) -> Vec<[f64; 3]> {
    let corners = outline(faces);
    let mut points = Vec::new();
    for (from, to) in corners.iter().zip(corners.iter().cycle().skip(1)) {
        for part in 0..PARTS {
            let share = part as f64 / PARTS as f64;
            let [x, z] = [0, 1].map(|i| from[i] + share * (to[i] - from[i]));
            points.extend([[x, -0.5, z], [x, 0.5, z]]);
        }
    }
    points.extend([-1., 1.].into_iter().flat_map(|y| [[0., y, -faces[3] / 2.], [0., y, faces[2] / 2.]]));
    points
}

/// Lets the faces grow in turn. A face grows by its step if the points of the new faces are attained; otherwise its step is halved.
///
/// * `largest` - largest distances
/// * `start` - distances whose points are attained
pub fn grow(largest: &Faces, start: Faces, attained: impl Fn(&Faces) -> bool) -> Faces {
    let (mut faces, mut halvings) = (start, [0; COUNT]);
    while halvings.iter().any(|&h| h <= HALVINGS) {
        for face in 0..COUNT {
            if halvings[face] > HALVINGS {
                continue;
            }
            let mut grown = faces;
            grown[face] = (faces[face] + FIRST_STEP * largest[face] / (1 << halvings[face]) as f64).min(largest[face]);
            // A face that the others cut off would grow without gain.
            let bounds = || face >= ALONG_Y || outline(&grown).iter().any(|&corner| along(face, corner) > grown[face] - 1e-9);
            if grown[face] > faces[face] && bounds() && attained(&grown) {
                faces = grown;
            } else {
                halvings[face] += 1;
            }
        }
    }
    faces
}

/// Share of the faces as the reach of a foot on the left or, mirrored, on the right. Sides end where the diagonals leave nothing of them.
pub fn reach(faces: &Faces, share: f64, mirrored: bool) -> FootReach {
    let rounded = |v: f64| (share * v * 1e4).trunc() / 1e4;
    let corners = outline(faces);
    let end = |face: usize| rounded(corners.iter().map(|&corner| along(face, corner)).fold(0., f64::max));
    let y = if mirrored { [-rounded(faces[8]), rounded(faces[9])] } else { [-rounded(faces[9]), rounded(faces[8])] };
    let slab = |face: usize| Slab { normal: NORMALS[face], sides: [-end(face + 1), end(face)] };
    FootReach { sides: [[-end(1), end(0)], y, [-end(3), end(2)]], diagonals: vec![slab(4), slab(6)] }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn faces_fill_a_leaning_region_that_no_box_fills() {
        // A foot that is higher must be further ahead: a parallelogram of 0.2 m by 0.2 m, and y within 0.1 m.
        let attained = |faces: &Faces| {
            let inside = |[x, y, z]: [f64; 3]| (x - z).abs() <= 0.1 && z.abs() <= 0.1 && y.abs() * faces[if y > 0. { 8 } else { 9 }] <= 0.1;
            points(faces).into_iter().all(inside)
        };
        let start = around(&[[0.02; 3]; 2], &[[1., 0.5, 0.], [0.5, 0.5, 1.]]);
        let largest = around(&[[0.3; 3]; 2], &[[1.; 3]]);
        assert!(attained(&start));
        let faces = grow(&largest, start, attained);
        assert!(attained(&faces));
        let area = |corners: &[[f64; 2]]| {
            let cross = |(a, b): (&[f64; 2], &[f64; 2])| a[0] * b[1] - a[1] * b[0];
            corners.iter().zip(corners.iter().cycle().skip(1)).map(cross).sum::<f64>() / 2.
        };
        // The largest box in it has 0.1 m by 0.1 m, an area of 0.01 m^2.
        let found = area(&outline(&faces));
        assert!(found > 0.018, "{found} m^2: {faces:?}");
        let [left, right] = [false, true].map(|mirrored| reach(&faces, 0.9, mirrored));
        let [inner, outer] = left.sides[1];
        assert_eq!([right.sides[0], right.sides[1]], [left.sides[0], [-outer, -inner]]);
        // Diagonals cut two corners, and no side lies beyond the outline.
        assert!(left.sides[0][1] + left.sides[2][1] > 0.13 && left.diagonals[1].sides[1] < 0.07, "{left:?}");
    }

    #[test]
    fn a_box_without_cuts_has_its_four_corners() {
        let faces = around(&[[0.1, 0.2, 0.3], [0.4, 0.5, 0.6]], &[[1.; 3]]);
        let close = |found: &[[f64; 2]], expected: &[[f64; 2]]| {
            found.iter().all(|a| expected.iter().any(|b| (a[0] - b[0]).abs() + (a[1] - b[1]).abs() < 1e-9))
        };
        let expected = [[-0.1, -0.3], [0.4, -0.3], [0.4, 0.6], [-0.1, 0.6]];
        let corners = outline(&faces);
        assert!(close(&corners, &expected) && close(&expected, &corners), "{corners:?}");
        let cut = outline(&Faces::from([0.4, 0.1, 0.6, 0.3, 0.5, 1., 1., 1., 0.1, 0.1]));
        // 0.6 x + 0.8 z <= 0.5 replaces the corner in front and above.
        assert!(close(&[[0.4, 0.325], [0.5 / 0.6 - 0.8, 0.6]], &cut) && !close(&[[0.4, 0.6]], &cut), "{cut:?}");
    }
}
