"""Programs of every format, with positions and much that looks like one."""

FANUC = b"""/PROG  WELD\r
/ATTR\r
COMMENT\t\t= "P[1] X = 1.0 mm";\r
/MN\r
   1:J P[2] 100% FINE    ;\r
   2:L P[1:start] 500mm/sec FINE    ;\r
   3:L PR[5] 500mm/sec FINE    ;\r
/POS\r
P[1:"start"]{\r
   GP1:\r
\tUF : 0, UT : 1,\t\tCONFIG : 'N U T, 0, 0, 0',\r
\tX =   450.000  mm,\tY =      .000  mm,\tZ =   200.000  mm,\r
\tW =  -180.000 deg,\tP =      .000 deg,\tR =      .000 deg\r
   GP2:\r
\tUF : 0, UT : 1,\t\r
\tJ1=   100.000  mm\r
};\r
P[2]{\r
   GP1:\r
\tUF : 3, UT : 1,\t\r
\tJ1=     5.000 deg,\tJ2=    10.000 deg,\tJ3=   -15.500 deg,\r
\tJ4=     2.000 deg,\tJ5=   -70.000 deg,\tJ6=      .500 deg\r
};\r
/END\r
"""

KUKA = b"""&ACCESS RVP
DEF weld ( )
DECL E6POS XHOME
$TOOL={X 10,Y 0,Z 100,A 0,B 0,C 0}
;FOLD PTP P1 {X 450,Y 0,Z 200,A 0,B 0,C 180}
$BASE=$NULLFRAME
PTP {A1 5,A2 -80.0,A3 90,A4 2,A5 60,A6 0.5} ; first
XHOME = {X 450,Y 10,Z 200,A 0,B 0,C 180,S 2,T 35,E1 0.0}
LIN {E6POS: X 450.0, Y 0.0, Z 200.0, A 0.0, B 0.0, C 180.0} C_DIS
PTP_REL {A1 10}
LIN_REL {X 1, Y 2, Z 3, A 0, B 0, C 0}
PTP {Z 100}
CIRC {X 450,Y 0,Z 200,A 0,B 0,C 180},{X 440,Y 5,Z 190,A 1,B 2,C 179}
END
"""

ABB = b"""MODULE Weld
  CONST robtarget p10:=[[450,0,200],[0,1,0,0],[0,-1,0,1],[9E+09,9E+09,9E+09,9E+09,9E+09,9E+09]];
  PERS tooldata tGun:=[TRUE,[[60,0,120],[1,0,0,0]],[0.8,[20,0,60],[1,0,0,0],0,0,0]];
  ! old: [[450,0,200],[0,1,0,0],[0,-1,0,1],[9E+09,9E+09,9E+09,9E+09,9E+09,9E+09]]
  CONST jointtarget home:=[[5,10,-15.5,2,-70,0.5],[9E+09,9E+09,9E+09,9E+09,9E+09,9E+09]];
  PROC main()
    TPWrite "go [[1,2,3],[1,0,0,0],[0,0,0,0],[0,0,0,0,0,0]]";
    MoveAbsJ home,v100,fine,tGun;
    MoveL p10,v100,fine,tGun\\WObj:=wobj0;
    MoveJ [[440,5.25,190],[0,1,0,0],[0,-1,-1,1],[9E+09,9E+09,9E+09,9E+09,9E+09,9E+09]],v100,z10,tGun;
  ENDPROC
ENDMODULE
"""

URSCRIPT = b"""def weld():
  # movej([1, 2, 3, 4, 5, 6])
  set_tcp(p[0.0, 0.0, 0.1, 0.0, 0.0, 0.0])
  global P1_p = p[0.45, 0.0, 0.2, 3.14159265, 0.0, 0.0]
  global P1_q = [0.1, 0.2, -0.3, 0.0, -1.2, 0.0]
  textmsg("p[0.45, 0.0, 0.2, 3.14, 0.0, 0.0]")
  movej([0.0873, 0.1745, -0.2705, 0.0349, -1.2217, 0.0087], a=1.4, v=1.05)
  movej(get_inverse_kin(P1_p, qnear=P1_q), a=1.4)
  movel(p[.44, .005, 0.19, 3.1, 0.1, 0.2], a=1.2, v=0.25)
  movel(pose_trans(P1_p, p[0, 0, 0.1, 0, 0, 0]), a=1.2)
  speedj([0.1, 0.2, 0.3, 0.1, 0, 0], 0.5, 0.5)
end
"""

ROBODK = b"""J1,J2,J3,J4,J5,J6,X,Y,Z\r
5,10,-15.5,2,-70,0.5,450,0,200\r
6.25, 10, -15.5, 2, -70, 0.5, 451, 0, 200\r
"""
