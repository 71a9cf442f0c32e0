//! Exists so that Cargo selects features of build dependencies too.

fn main() {}
