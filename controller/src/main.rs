//! The program `controller`: start-up only; the loop lives in the library.

fn main() {}
