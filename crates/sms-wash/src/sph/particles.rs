//! The particles as a structure of arrays.

use super::lanes::WIDTH;

/// Coordinate of padding particles, beyond any kernel's reach.
const FAR: f32 = 1e6;

/// All particles have the same mass. Arrays are padded by the width of a vector.
#[derive(Debug, Clone, Default)]
pub(super) struct Particles {
    len: usize,
    /// Positions in the world, metres.
    pub(super) x: [Vec<f32>; 3],
    /// Velocities in the world, m/s.
    pub(super) v: [Vec<f32>; 3],
    /// Ages, seconds.
    pub(super) age: Vec<f32>,
    /// Densities, kg/m³.
    pub(super) density: Vec<f32>,
    /// Pressure over squared density.
    pub(super) pressure: Vec<f32>,
    /// Accelerations, m/s².
    pub(super) acceleration: Vec<[f32; 3]>,
}

impl Particles {
    /// An empty set with this capacity.
    pub(super) fn with_capacity(capacity: usize) -> Self {
        let room = || Vec::with_capacity(capacity + WIDTH);
        Self {
            len: 0,
            x: std::array::from_fn(|_| room()),
            v: std::array::from_fn(|_| room()),
            age: room(),
            density: room(),
            pressure: room(),
            acceleration: Vec::with_capacity(capacity + WIDTH),
        }
    }

    pub(super) fn len(&self) -> usize {
        self.len
    }

    pub(super) fn position(&self, i: usize) -> [f32; 3] {
        [self.x[0][i], self.x[1][i], self.x[2][i]]
    }

    pub(super) fn velocity(&self, i: usize) -> [f32; 3] {
        [self.v[0][i], self.v[1][i], self.v[2][i]]
    }

    /// Resizes to `len` particles; new ones have arbitrary states.
    pub(super) fn resize(&mut self, len: usize) {
        self.len = len;
        for axis in 0..3 {
            self.x[axis].resize(len + WIDTH, FAR);
            self.x[axis][len..].fill(FAR);
            self.v[axis].resize(len + WIDTH, 0.0);
            self.v[axis][len..].fill(0.0);
        }
        self.age.resize(len, 0.0);
    }

    pub(super) fn set(&mut self, i: usize, x: [f32; 3], v: [f32; 3], age: f32) {
        for axis in 0..3 {
            self.x[axis][i] = x[axis];
            self.v[axis][i] = v[axis];
        }
        self.age[i] = age;
    }

    pub(super) fn push(&mut self, x: [f32; 3], v: [f32; 3], age: f32) {
        let i = self.len;
        self.resize(i + 1);
        self.set(i, x, v, age);
    }

    /// Reorders the particles of `self`: particle `i` moves to `place[i]` of `sorted`.
    pub(super) fn scatter(&self, place: &[u32], sorted: &mut Self) {
        sorted.resize(self.len);
        for axis in 0..3 {
            for (i, &to) in place.iter().enumerate() {
                sorted.x[axis][to as usize] = self.x[axis][i];
                sorted.v[axis][to as usize] = self.v[axis][i];
            }
        }
        for (i, &to) in place.iter().enumerate() {
            sorted.age[to as usize] = self.age[i];
        }
    }

    /// Copies the state (positions, velocities, ages) and keeps the allocations.
    pub(super) fn copy_from(&mut self, other: &Self) {
        let len = other.len;
        self.resize(len);
        // Excludes the padding, which an empty set lacks.
        for axis in 0..3 {
            self.x[axis][..len].copy_from_slice(&other.x[axis][..len]);
            self.v[axis][..len].copy_from_slice(&other.v[axis][..len]);
        }
        self.age.copy_from_slice(&other.age);
    }

    /// Sum of all velocities.
    pub(super) fn velocity_sum(&self) -> [f64; 3] {
        std::array::from_fn(|a| self.v[a][..self.len].iter().map(|v| f64::from(*v)).sum())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn air_in_which_nothing_ever_was_can_be_returned_to() {
        let (mut air, none) = (Particles::with_capacity(4), Particles::default());
        air.push([0.1; 3], [1.0; 3], 0.0);
        air.copy_from(&none);
        assert_eq!(air.len(), 0);
        let mut saved = Particles::default();
        saved.copy_from(&Particles::with_capacity(4));
        assert_eq!(saved.velocity_sum(), [0.0; 3]);
    }
}
