"""Names of the frames in a replay, and the transforms between them."""

from __future__ import annotations

from dataclasses import dataclass

from beamseg_batch.geometry import RigidTransform
from beamseg_batch.model import RecordingInfo

__all__ = ["ViewFrames"]


@dataclass(frozen=True, eq=False)
class ViewFrames:
    """Frames by the names that they have in the recording.

    Attributes
    ----------
    world, body, camera : str
        All different, but for the body's where the recording has none for it and the
        camera sits at its origin: that is the camera's then.
    T_body_camera : RigidTransform
        In the camera's own axes, which are those of the recorded clouds.
    T_camera_sensor : RigidTransform
        From the axes of the scans to these.
    """

    world: str
    body: str
    camera: str
    T_body_camera: RigidTransform
    T_camera_sensor: RigidTransform

    @classmethod
    def of(cls, recording: RecordingInfo) -> ViewFrames:
        """Choose the names of a recording's frames.

        Parameters
        ----------
        recording : RecordingInfo

        Returns
        -------
        ViewFrames

        Notes
        -----
        Recordings of the original node have one name for the drone and its camera. The
        clouds are in it, so it is the camera's; the drone's is derived from it.
        """
        world = recording.world_frame or "world"
        camera = recording.sensor_frame or "camera"
        if camera == world:
            camera = f"{world}_camera"
        body = recording.body_frame or f"{camera}_body"
        T_camera_sensor = recording.T_cloud_sensor
        T_body_camera = recording.T_body_sensor @ T_camera_sensor.inverse()
        is_camera = not (T_body_camera.translation.any() or _is_turned(T_body_camera))
        if body in (world, camera):
            body = camera if is_camera else f"{camera}_body"
        return cls(world, body, camera, T_body_camera, T_camera_sensor)

    @property
    def has_extrinsic(self) -> bool:
        """Whether body and camera are two frames."""
        return self.body != self.camera


def _is_turned(transform: RigidTransform) -> bool:
    return bool((transform.rotation != RigidTransform.identity().rotation).any())
