//! Tasks as data: actions, objectives, trajectories and the one rollout that planner and target share.
