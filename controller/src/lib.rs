//! The real-time controller: a pure step, the loop around it and the second thread that talks.
