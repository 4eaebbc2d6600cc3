//! Nesterov momentum with restart.
use crate::real::Real;
pub struct Momentum<R: Real> { _old: Vec<R> }
impl<R: Real> Momentum<R> { pub fn new() -> Self { Self { _old: Vec::new() } } }
