from drivers.fanuc.modbus import FanucModbusArm, FanucModbusConfig
from drivers.sim.modbus_controller import ModbusController
from srvs_cell.geometry import Xyzwpr
from tests.drivers.stepped import PointArm, SteppedClock, SteppedTime


async def test_moves_over_a_real_socket() -> None:
    time = SteppedTime()
    point = PointArm(time)
    controller = ModbusController(point, time)
    port = controller.start()
    clock = SteppedClock(time)
    arm = FanucModbusArm(FanucModbusConfig(port=port), clock)
    clock.busy = lambda: arm._wire.busy
    try:
        await arm.connect()
        await arm.activate()
        target = Xyzwpr(600.0, 50.0, 300.0, 180.0, 0.0, 30.0)
        begun = clock.now_s()
        assert await arm.move_linear(target, 100.0) == target
        assert 1.5 < clock.now_s() - begun < 2.0
        assert controller.motions_started == 1
        await arm.disconnect()
    finally:
        time.release()
        controller.close()
